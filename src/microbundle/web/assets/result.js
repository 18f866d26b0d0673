// The result: the report as the command line writes it, in a frame of its own, and the files of this movie.

import { fileOf, pageOf } from "./api.js";
import { make } from "./shared.js";
import { bytes } from "./page.js";

export async function startResult(panel, movie) {
  const refresh = () => {
    const { result } = movie;
    if (!movie.measured) {
      const words =
        movie.state === "failed"
          ? movie.message || result?.message || "This movie could not be measured."
          : movie.state === "running"
            ? "It is being measured. This page shows the report as soon as it is there."
            : "This movie is not measured yet. Start the run first.";
      panel.replaceChildren(
        make("p", { class: "reason" }, words),
        make("p", {}, make("a", { class: "button", href: pageOf(movie.run) }, "Go to the run")),
      );
      return;
    }
    const frame = make("iframe", {
      class: "report",
      title: `Report of ${movie.movie}`,
      src: `${movie.base}/report`,
      sandbox: "allow-scripts allow-popups",
    });
    panel.replaceChildren(
      make(
        "p",
        { class: "choices" },
        make("a", { class: "button", href: `${movie.base}/report`, target: "_blank" }, "Open the report by itself"),
        make(
          "a",
          {
            class: "button",
            download: true,
            href: `/api/runs/${encodeURIComponent(movie.run)}/zip?movies=${encodeURIComponent(movie.key)}`,
          },
          "Download this movie’s files (ZIP)",
        ),
      ),
      frame,
      make(
        "details",
        {},
        make("summary", {}, "Files of this movie"),
        make(
          "ul",
          { class: "files" },
          ...(result.files ?? []).map((file) =>
            make(
              "li",
              {},
              make(
                "a",
                { href: fileOf(movie.run, file.path ?? `results/${movie.key}/${file.name}`), download: true },
                file.name,
              ),
              " ",
              make("span", { class: "note" }, bytes(file.bytes)),
            ),
          ),
        ),
      ),
    );
  };
  refresh();
  return { refresh };
}
