// One run: what is next, its movies as table and plate, its settings, its command, and its files.

import { fileOf, follow, get, ofRun, pageOf, post, send } from "./api.js";
import { Plates } from "./plate.js";
import { Keeper, SettingsForm, toSetting } from "./settings.js";
import { Table } from "./table.js";
import { byId, make, withError } from "./shared.js";
import {
  MEANING,
  badge,
  bytes,
  connection,
  counted,
  does,
  duration,
  madeBadge,
  moment,
  onClick,
  say,
  trouble,
} from "./page.js";

const id = byId("main").dataset.run;
const picked = new Set(),
  keeper = new Keeper(id, () => run, heard);
let run = null,
  movies = new Map(),
  table = null,
  plates = null,
  settings = null,
  platesOf = "",
  filesOf = "";

let unfollow = () => {};

// Hears of the run until it is unfollowed; `then` is called each time.
function listen(then = () => {}) {
  unfollow = follow(`${ofRun(id)}/events`, "run", (now) => then(heard(now)), connection);
}

// --- what is heard -------------------------------------------------------------------------------------------------

function heard(now) {
  if (now.movies_changed) {
    for (const movie of now.movies_changed) movies.set(movie.key, movie);
    run = { ...run, ...now };
  } else {
    const before = run?.state;
    run = now;
    movies = new Map(now.movies.map((movie) => [movie.key, movie]));
    if (before && before !== run.state) say(nextText());
  }
  render();
}

function render() {
  byId("title").textContent = run.title;
  byId("crumb").textContent = run.title;
  document.title = `${run.title} – microbundle`;
  badge(byId("state"), run.state);
  byId("what").textContent = [
    counted(movies.size, "movie"),
    run.source,
    run.started ? `started ${moment(run.started)}` : "",
  ]
    .filter(Boolean)
    .join(" · ");
  byId("command").textContent = run.command;
  renderNext();
  if (!byId("table").hidden) showTable();
  settings?.show(byId("ask").dataset.for?.split(","));
  showPlate().catch(trouble);
  showFiles().catch(trouble);
}

// --- the next step -------------------------------------------------------------------------------------------------

const all = () => [...movies.values()];
const count = (keep) => all().filter(keep).length;
const waiting = () => count((movie) => movie.stale || movie.state === "todo");

function nextText() {
  const { total = movies.size, done = 0, seconds_left: left = null } = run.progress ?? {},
    missing = run.missing ?? {};
  const unknown = [
    missing.fps && !run.settings?.fps ? "the frame rate" : "",
    missing.um_per_px && !run.settings?.um_per_px ? "the pixel size" : "",
  ]
    .filter(Boolean)
    .join(" and ");
  switch (run.state) {
    case "draft":
      return !movies.size
        ? "No movie was found here. Open another folder."
        : unknown
          ? `Some files do not say ${unknown}. Fill in what you know; left empty, results are in frames and pixels.`
          : "Everything that is needed is known.";
    case "preparing":
      return "The example plate is being rendered. That takes a minute.";
    case "queued":
      return "Waits until the run before it has ended.";
    case "running":
      return (
        `${done} of ${total} measured${left ? `, about ${duration(left)} left` : ""}. You may close this page; ` +
        "the run goes on."
      );
    case "stopped":
      return `${run.message || "Stopped."} ${done} of ${total} are measured, and kept.`;
    case "failed":
      return run.message;
    default: {
      const parts = [
        ["pass", "pass"],
        ["review", "to be looked at"],
        ["fail", "not to be trusted"],
      ].map(([verdict, words]) => [count((movie) => movie.verdict === verdict), words]);
      const broken = count((movie) => movie.state === "failed");
      const text = [...parts, [broken, "could not be measured"]]
        .filter(([n]) => n)
        .map(([n, words]) => `${n} ${words}`)
        .join(", ");
      return waiting()
        ? `${counted(waiting(), "movie")} ${waiting() === 1 ? "is" : "are"} new, or changed since they were measured.`
        : `Measured: ${text}. Open a movie to look at it, or take everything away.`;
    }
  }
}

function renderNext() {
  const { state, progress = {} } = run,
    running = ["running", "preparing"].includes(state);
  byId("next-text").textContent = nextText();
  const text = {
    draft: `Start measuring ${counted(movies.size, "movie")}`,
    stopped: "Go on",
    failed: "Try again",
    done: waiting() ? `Measure ${counted(waiting(), "movie")}` : null,
  }[state];
  byId("go").hidden = !text || !movies.size;
  byId("go").textContent = text ?? "";
  byId("cancel").hidden = !["running", "queued"].includes(state);
  byId("clear").hidden = ["running", "queued", "preparing"].includes(state);
  byId("zip").hidden = !count((movie) => movie.state === "done");
  byId("zip").classList.toggle("main", state === "done" && !waiting());
  byId("progress").hidden = !running && state !== "stopped";
  byId("bar").value = progress.share ?? 0;
  byId("left").textContent = running ? `${Math.floor(100 * (progress.share ?? 0))} %` : "";
  byId("side").disabled = picked.size !== 2;
  const asked =
    state === "draft" && movies.size
      ? [
          ["fps", "Frames per second", "frames/s"],
          ["um_per_px", "Pixel size", "µm per pixel"],
        ].filter(([key]) => run.missing?.[key])
      : [];
  if (byId("ask").dataset.for !== asked.join()) {
    byId("ask").dataset.for = asked.join();
    byId("ask").replaceChildren(
      make("div", { class: "ask" }, ...asked.map(([key, label, unit]) => question(key, label, unit))),
    );
  }
}

function question(key, label, unit) {
  const input = make("input", {
    type: "number",
    min: 0,
    step: "any",
    inputmode: "decimal",
    value: run.settings?.[key] ?? "",
  });
  const wrong = make("span", { class: "wrong", role: "alert" }),
    keep = keeper.typed({ input, wrong });
  input.addEventListener("input", () => keep(toSetting(key, input.value === "" ? null : Number(input.value))));
  return make(
    "label",
    {},
    make("span", {}, `${label} `, make("span", { class: "unit" }, unit)),
    input,
    make("span", { class: "note" }, `${counted(run.missing[key], "movie")} without`),
    wrong,
  );
}

// --- movies --------------------------------------------------------------------------------------------------------

const told = (movie, name) => movie.columns?.[name] ?? "";

// Columns of the plan that tell movies apart; the others are told once.
function varying() {
  const [first] = movies.values();
  return (run.columns ?? []).filter(
    (name) => movies.size === 1 || all().some((movie) => told(movie, name) !== told(first, name)),
  );
}

function remark() {
  const [first] = movies.values(),
    shown = varying(),
    same = (run.columns ?? []).filter((name) => !shown.includes(name) && told(first, name) !== "");
  const words = same.length
    ? ` The same for all: ${same.map((name) => `${name} ${told(first, name)}`).join(", ")}.`
    : "";
  return `${(run.metrics ?? []).length ? MEANING : ""}${words}`;
}

function columns() {
  const metrics = run.metrics ?? [];
  return [
    {
      id: "movie",
      label: "Movie",
      rowHead: true,
      value: (movie) => movie.movie,
      cell: (movie) => make("a", { href: pageOf(id, movie.key) }, movie.movie),
    },
    { id: "pick", label: "Chosen to compare", look: "pick", cell: pick },
    ...varying().map((name) => ({
      id: `column ${name}`,
      label: name,
      look: "label",
      value: (movie) => movie.columns?.[name] ?? null,
    })),
    { id: "state", label: "State", words: true, value: (movie) => movie.verdict || movie.state, cell: state },
    { id: "beats", label: "Beats", value: (movie) => movie.beats ?? null },
    ...metrics.map((one) => ({
      id: one.column,
      label: one.label,
      unit: one.unit,
      tip: one.tip,
      value: (movie) => movie.metrics?.[one.column] ?? null,
      cell: (movie) => {
        const value = movie.metrics?.[one.column] ?? null;
        return value === null ? "–" : withError(value, movie.se?.[one.column]);
      },
    })),
  ];
}

function pick(movie) {
  const box = make("input", { type: "checkbox", "aria-label": `Compare ${movie.movie}` });
  box.checked = picked.has(movie.key);
  box.addEventListener("change", () => {
    if (box.checked) picked.add(movie.key);
    else picked.delete(movie.key);
    byId("side").disabled = picked.size !== 2;
    say(`${counted(picked.size, "movie")} chosen; two can be compared.`);
  });
  return box;
}

function state(movie) {
  const shown = [madeBadge(movie.verdict && movie.state === "done" ? movie.verdict : movie.state)];
  if (movie.accepted === true) shown.push(" accepted");
  if (movie.accepted === false) shown.push(" rejected");
  if (movie.stale) shown.push(" changed since");
  const told =
    movie.state === "running" ? `${movie.stage ?? ""} ${Math.round(100 * (movie.share ?? 0))} %` : movie.message;
  if (told) shown.push(make("span", { class: "stage-note" }, told));
  return shown;
}

function showTable() {
  table ??= new Table(byId("table"), {
    label: "Table of movies",
    key: (movie) => movie.key,
    columns: columns(),
    first: "movie",
  });
  table.setColumns(columns());
  table.note.textContent = remark();
  table.show(all());
}

async function showPlate() {
  if (byId("plate").hidden) return;
  plates ??= new Plates(byId("plate"), id);
  const of = JSON.stringify([run.pattern, run.columns, run.metrics, movies.size]);
  if (of !== platesOf) {
    platesOf = of;
    const { plates: found } = await get(`${ofRun(id)}/plate`);
    plates.place(found, run.metrics ?? []);
  }
  plates.paint(movies);
}

function view(plate) {
  byId("table").hidden = plate;
  byId("plate").hidden = !plate;
  byId("find-label").hidden = plate;
  byId("as-table").setAttribute("aria-pressed", !plate);
  byId("as-plate").setAttribute("aria-pressed", plate);
  history.replaceState(null, "", plate ? "#plate" : location.pathname);
  if (run && !plate) showTable();
  return run ? showPlate() : null;
}

// --- files --------------------------------------------------------------------------------------------------------

const fileLine = (file) =>
  make(
    "li",
    {},
    make("a", { href: fileOf(id, file.path), download: true }, file.path),
    " ",
    make("span", { class: "note" }, [file.what, bytes(file.bytes)].filter(Boolean).join(" · ")),
  );

// Files of a folder, closed at first; its pictures are seen at once.
function fileFolder(name, files) {
  const pictures = files.filter((file) => file.path.endsWith(".png"));
  return make(
    "details",
    {},
    make("summary", {}, name, make("span", { class: "note" }, counted(files.length, "file"))),
    make(
      "div",
      { class: "pictures" },
      ...pictures.map((file) =>
        make("img", { src: `${fileOf(id, file.path)}?inline=1`, alt: file.path, loading: "lazy" }),
      ),
    ),
    make("ul", { class: "files" }, ...files.map(fileLine)),
  );
}

async function showFiles() {
  const of = `${run.state} ${run.ended} ${count((movie) => movie.state === "done")}`;
  const settled = !["running", "queued"].includes(run.state);
  if (of === filesOf || !settled || run.state === "draft") return;
  filesOf = of;
  const { files } = await get(`${ofRun(id)}/outputs`);
  const folders = [...new Set(files.map((file) => file.path.split("/").slice(0, -1)[0]).filter(Boolean))];
  byId("files-section").hidden = !files.length;
  byId("files").replaceChildren(
    make("ul", { class: "files" }, ...files.filter((file) => !file.path.includes("/")).map(fileLine)),
    ...folders.map((name) =>
      fileFolder(
        (name[0].toUpperCase() + name.slice(1)).replaceAll("_", " "),
        files.filter((file) => file.path.startsWith(`${name}/`)),
      ),
    ),
  );
}

// --- what is pressed -----------------------------------------------------------------------------------------------

onClick(byId("go"), async () => {
  await keeper.last;
  await post(`${ofRun(id)}/start`);
  heard(await get(ofRun(id)));
});
onClick(byId("cancel"), async () => {
  await post(`${ofRun(id)}/cancel`);
  say("Stopping. What is measured is kept.");
});
onClick(byId("clear"), async () => {
  const words = run.elsewhere
    ? "Its results stay where they are."
    : count((movie) => movie.state === "done")
      ? "Its results are moved to the workspace’s folder trash."
      : "It has no results.";
  if (!confirm(`Take “${run.title}” off the list? ${words}`)) return;
  unfollow(); // that it is gone is no news here, and would lead away from the page a second time
  try {
    await send("DELETE", ofRun(id));
  } catch (error) {
    listen();
    throw error;
  }
  location.assign("/");
});
onClick(byId("rename"), async () => {
  const title = prompt("Name of this run", run.title);
  if (title?.trim()) heard(await send("PATCH", ofRun(id), { title: title.trim() }));
});
byId("find").addEventListener("input", () => table?.find(byId("find").value));
byId("as-table").addEventListener("click", () => view(false).catch(trouble));
byId("as-plate").addEventListener("click", () => does(byId("as-plate"), () => view(true)));
byId("side").addEventListener("click", () => {
  const [a, b] = all()
    .map((movie) => movie.key)
    .filter((key) => picked.has(key));
  location.assign(`${pageOf(id)}/side?a=${encodeURIComponent(a)}&b=${encodeURIComponent(b)}`);
});
byId("copy").addEventListener("click", async () => {
  try {
    await navigator.clipboard.writeText(byId("command").textContent);
    say("Copied.");
    byId("copy").textContent = "Copied";
  } catch {
    getSelection().selectAllChildren(byId("command"));
    say("Selected; copy it with Ctrl-C or ⌘C.");
  }
});
byId("zip").href = `${ofRun(id)}/zip?movies=all`;
byId("zip").setAttribute("download", "");

try {
  if (location.hash === "#plate") view(true);
  // The first event is the whole run; asking for it besides would take a large plate twice the time.
  const first = new Promise(listen);
  const form = new SettingsForm(byId("settings"), keeper);
  await Promise.all([form.start(), first]);
  settings = form;
  settings.show(byId("ask").dataset.for.split(","));
} catch (error) {
  trouble(error);
}
