// The movie itself, what its file says of it, and which of several recordings it is.

import { get, ofRun, pageOf, send } from "./api.js";
import { changed } from "./settings.js";
import { make } from "./shared.js";
import { Viewer } from "./viewer.js";
import { button } from "./page.js";

const SOURCES = { file: "from the file", user: "given", unknown: "not known" };

export async function startFrames(panel, movie) {
  const left = make("div"),
    side = make("div", { class: "side" });
  panel.replaceChildren(make("div", { class: "beside" }, left, side));
  new Viewer(left, {
    base: movie.base,
    info: movie.info,
    label: `Movie ${movie.movie}. Space plays, arrow keys step.`,
    state: movie.frame,
  });
  const refresh = () => side.replaceChildren(...facts(movie));
  refresh();
  return { refresh };
}

function facts(movie) {
  const { info } = movie,
    number = (value, unit, source) =>
      value ? `${Number(value.toPrecision(5))} ${unit}, ${SOURCES[source] ?? source}` : "not known";
  const told = [
    ["frames", `${info.frames}`],
    ["size", `${info.rows} rows × ${info.cols} columns`],
    ["frame rate", number(info.frames_per_s, "frames/s", info.time_source)],
    ["duration", info.duration_s ? `${info.duration_s.toFixed(2)} s` : "not known"],
    ["pixel size", number(info.um_per_px, "µm", info.um_per_px_source)],
    ["format", info.format],
    ["masks with it", info.masks?.length ? info.masks.join(", ") : "none"],
  ];
  const out = [
    make("h2", {}, "What is known"),
    make(
      "dl",
      { class: "facts" },
      ...told.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value ?? "")]),
    ),
  ];
  const missing = [!info.frames_per_s && "frame rate", !info.um_per_px && "pixel size"].filter(Boolean);
  if (missing.length) {
    out.push(
      make(
        "p",
        { class: "reason" },
        `The file does not say its ${missing.join(" and ")}. Give it for all movies in the `,
        make("a", { href: `${pageOf(movie.run)}` }, "settings of the run"),
        ".",
      ),
    );
  }
  if (info.findings?.length)
    out.push(
      make("ul", { class: "told" }, ...info.findings.map((one) => make("li", { class: one.level }, one.message))),
    );
  return out;
}

// A file with several recordings: which one is meant, for all movies of the run.
export function showChoice(panel, movie) {
  const { text, series } = movie.to_choose,
    named = (one, i) => `${i}: ${one.name ?? "without a name"}`;
  const which = make(
    "select",
    { name: "series" },
    ...series.map((one, i) => make("option", { value: i }, named(one, i))),
  );
  const numbers = ["channel", "z"].map((name) => make("input", { type: "number", min: 0, name }));
  const take = button(
    "Take this one",
    async () => {
      const { settings } = await get(ofRun(movie.run));
      const asked = [which, ...numbers].filter((one) => one.value !== "");
      await send("PATCH", ofRun(movie.run), {
        settings: asked.reduce((tree, one) => changed(tree, `reading.${one.name}`, Number(one.value)), settings ?? {}),
      });
      location.reload();
    },
    { class: "main" },
  );
  panel.replaceChildren(
    make("p", { class: "reason" }, text),
    make(
      "div",
      { class: "ask" },
      make("label", {}, "Recording ", which),
      make("label", {}, "Channel, counted from 0 ", numbers[0]),
      make("label", {}, "Focal plane, counted from 0 ", numbers[1]),
    ),
    make("p", { class: "choices" }, take),
    make("p", { class: "note" }, "It holds for all movies of this run."),
  );
}
