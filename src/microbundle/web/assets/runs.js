// The list of runs, newest first.

import { pageOf } from "./api.js";
import { make } from "./shared.js";
import { counted, duration, madeBadge, moment } from "./page.js";

export function showRuns(host, runs) {
  if (!runs.length) {
    host.replaceChildren(make("p", { class: "note" }, "None yet. Open a movie or a folder, and it is listed here."));
    return;
  }
  const focused = document.activeElement?.closest?.("#runs a")?.getAttribute("href");
  host.replaceChildren(
    make(
      "ul",
      { class: "runs" },
      ...runs.map((run) => {
        const parts = [counted(run.movies, "movie"), moment(run.created)];
        if (run.failed) parts.push(`${run.failed} failed`);
        if (run.state === "running" && run.seconds_left) parts.push(`about ${duration(run.seconds_left)} left`);
        const item = make(
          "li",
          { class: "raised" },
          make(
            "div",
            { class: "heading" },
            make("a", { class: "name", href: pageOf(run.id) }, run.title),
            madeBadge(run.state),
          ),
          make("p", { class: "note" }, parts.filter(Boolean).join(" · ")),
        );
        if (run.state === "running") {
          item.append(make("progress", { max: 1, value: run.share ?? 0, "aria-label": `Done of ${run.title}` }));
        }
        return item;
      }),
    ),
  );
  if (focused) [...host.querySelectorAll("a")].find((link) => link.getAttribute("href") === focused)?.focus();
}
