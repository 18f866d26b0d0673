// The movie itself, what its file says of it, and which of several recordings it is.

import { pageOf } from "./api.js";
import { make } from "./shared.js";
import { Viewer } from "./viewer.js";
import { does, trouble } from "./page.js";

const SOURCES = { file: "from the file", user: "given by you", unknown: "not known" };

export async function startFrames(panel, movie) {
  const left = make("div"), side = make("div", { class: "side" });
  panel.replaceChildren(make("div", { class: "beside" }, left, side));
  new Viewer(left, { base: movie.base, info: movie.info, label: `Movie ${movie.movie}. Space plays, arrow keys step.`, state: movie.frame });
  const refresh = () => side.replaceChildren(...facts(movie));
  refresh();
  return { refresh };
}

function facts(movie) {
  const { info } = movie, number = (value, unit, source) => (value ? `${Number(value.toPrecision(5))} ${unit}, ${SOURCES[source] ?? source}`
    : "not known");
  const told = [["frames", `${info.frames}`], ["size", `${info.rows} rows × ${info.cols} columns`],
    ["frame rate", number(info.frames_per_s, "frames/s", info.time_source)],
    ["duration", info.duration_s ? `${info.duration_s.toFixed(2)} s` : "not known"],
    ["pixel size", number(info.um_per_px, "µm", info.um_per_px_source)], ["format", info.format],
    ["masks with it", info.masks?.length ? info.masks.join(", ") : "none"]];
  const out = [make("h2", {}, "What is known"), make("dl", { class: "facts" }, ...told.flatMap(([name, value]) => [make("dt", {}, name),
    make("dd", {}, value ?? "")]))];
  const missing = [!info.frames_per_s && "frame rate", !info.um_per_px && "pixel size"].filter(Boolean);
  if (missing.length) {
    out.push(make("p", { class: "reason" }, `The file does not say its ${missing.join(" and ")}. Give it for all movies in the `,
      make("a", { href: `${pageOf(movie.run)}` }, "settings of the run"), "."));
  }
  if (info.findings?.length) out.push(make("ul", { class: "told" }, ...info.findings.map((one) => make("li", { class: one.level }, one.message))));
  if (movie.to_choose?.series?.length > 1) out.push(choice(movie));
  return out;
}

// A file with several recordings: which one this is, as a decision on this movie.
function choice(movie) {
  const now = movie.decisions.findLast((one) => one.kind === "settings" && one.settings.reading?.series !== undefined)?.settings.reading.series;
  const select = make("select", {}, ...movie.to_choose.series.map((name, i) => make("option", { value: i, selected: i === (now ?? 0) },
    typeof name === "string" ? name : name.name ?? `${i}`)));
  select.addEventListener("change", () => does(select, async () => {
    await movie.save((decisions) => [...decisions.filter((one) => one.settings?.reading?.series === undefined),
      { kind: "settings", settings: { reading: { series: Number(select.value) } }, ...movie.sign() }]);
    location.reload();
  }).catch(trouble));
  return make("label", { class: "field" }, "Recording of this file ", select);
}
