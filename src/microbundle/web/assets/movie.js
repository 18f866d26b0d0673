// One movie: its tabs, what is known of it, and its decisions, which several windows may change.

import { follow, get, ofMovie, ofRun, pageOf, post, send } from "./api.js";
import { startBeats } from "./beats.js";
import { showChoice, startFrames } from "./movie_frames.js";
import { startMasks } from "./masks.js";
import { startNotes } from "./notes.js";
import { startResult } from "./result.js";
import { startVerify } from "./verify.js";
import { State, byId, make } from "./shared.js";
import { badge, connection, drafts, onClick, say, startTabs, trouble } from "./page.js";

const TABS = {
  movie: startFrames,
  masks: startMasks,
  result: startResult,
  beats: startBeats,
  verify: startVerify,
  notes: startNotes,
};

class Movie {
  constructor(run, key) {
    Object.assign(this, { run, key, base: ofMovie(run, key), frame: new State({ frame: 0 }), started: {} });
  }

  async load() {
    Object.assign(this, await get(this.base));
  }

  get measured() {
    return this.result.files.some((file) => file.name === "result.nc");
  }

  sign(why = "") {
    const by = drafts.get("person") ?? "";
    return {
      ...(why ? { why } : {}),
      ...(by ? { by } : {}),
      at: new Date().toISOString().replace(/\.\d+Z$/, "+00:00"),
    };
  }

  // `edit` makes the new list of an older one, so that it can be made once more where another window was faster.
  // One is kept after the other.
  save(edit, masks = {}) {
    const kept = (this.saving ?? Promise.resolve()).then(() => this.keep(edit, masks));
    this.saving = kept.catch(() => {});
    return kept;
  }

  async keep(edit, masks) {
    const put = () =>
      send("PUT", `${this.base}/decisions`, { decisions: edit(this.decisions), masks, version: this.version });
    let kept;
    try {
      kept = await put();
    } catch (error) {
      if (error.status !== 409) throw error;
      Object.assign(this, { decisions: error.body.decisions, version: error.body.version });
      kept = await put();
      trouble(
        "This movie was changed in another window meanwhile. Both changes are kept; see Notes and decisions.",
        "both",
      );
    }
    Object.assign(this, { decisions: kept.decisions, version: kept.version });
    await this.load();
    this.renew();
  }

  renew() {
    show(this);
    for (const tab of Object.values(this.started)) tab.then((one) => one?.refresh?.()).catch(trouble);
  }
}

function show(movie) {
  const { info, result } = movie;
  byId("title").textContent = movie.movie;
  document.title = `${movie.movie} – microbundle`;
  byId("crumb-run").textContent = movie.title ?? "Run";
  badge(byId("state"), movie.state === "done" ? (result?.verdict ?? "done") : movie.state);
  const facts = info && [
    `${info.frames} frames`,
    `${info.rows} × ${info.cols} px`,
    info.frames_per_s ? `${Number(info.frames_per_s.toPrecision(4))} frames/s` : "frame rate not known",
    info.um_per_px ? `${Number(info.um_per_px.toPrecision(4))} µm/px` : "pixel size not known",
    info.format,
  ];
  byId("what").textContent = (facts ?? []).filter(Boolean).join(" · ");
  byId("stale").hidden = !movie.stale;
  for (const [id, key] of [
    ["previous", movie.previous],
    ["following", movie.next],
  ]) {
    byId(id).hidden = !key;
    if (key) byId(id).href = `${pageOf(movie.run, key)}${location.hash}`;
  }
}

async function start() {
  const { run, key } = byId("main").dataset,
    movie = new Movie(run, key);
  await movie.load();
  show(movie);
  startTabs(byId("tabs"), (name) => {
    const panel = byId(`panel-${name}`);
    for (const id of ["previous", "following"]) byId(id).href = byId(id).href.replace(/#.*|$/, `#${name}`);
    if (movie.to_choose && name === "movie") {
      showChoice(panel, movie);
      return;
    }
    if (!movie.info && !["result", "notes"].includes(name)) {
      panel.replaceChildren(
        make(
          "p",
          { class: "reason" },
          movie.problem?.message ?? movie.to_choose?.text ?? movie.message ?? "This movie cannot be read.",
        ),
      );
      return;
    }
    if (!movie.started[name]) panel.replaceChildren(make("p", { class: "note" }, "Reading …"));
    movie.started[name] ??= TABS[name](panel, movie).catch((error) => {
      delete movie.started[name];
      panel.replaceChildren(make("p", { class: "reason" }, error.message));
      trouble(error);
    });
  });
  onClick(byId("again"), async () => {
    await post(`${ofRun(run)}/start`);
    say("The movie is measured again.");
  });
  let before = `${movie.state} ${movie.stale}`;
  follow(
    `${ofRun(run)}/events`,
    "run",
    async (now) => {
      const mine = (now.movies_changed ?? now.movies).find((one) => one.key === key);
      if (!mine) return;
      badge(byId("state"), mine.state === "done" ? (mine.verdict ?? "done") : mine.state);
      byId("again").textContent =
        mine.state === "running"
          ? `Measuring, ${Math.round(100 * (mine.share ?? 0))} %`
          : now.state === "queued" || now.state === "running"
            ? "Waiting to be measured"
            : "Measure again";
      byId("again").disabled = ["queued", "running"].includes(now.state);
      const after = `${mine.state} ${mine.stale}`;
      if (after === before) return;
      const ran = before.startsWith("running");
      before = after;
      try {
        await movie.load();
        movie.renew();
        if (ran && mine.state === "done") say("Measured. The result is renewed.");
      } catch (error) {
        trouble(error);
      }
    },
    connection,
  );
}

start().catch(trouble);
