// Two movies side by side: frames in step by time or by the phase of the beat, traces over each other, key numbers.

import { get, ofMovie, ofRun, pageOf } from "./api.js";
import { Chart, State, byId, make, nearest, withError, written } from "./shared.js";
import { Viewer } from "./viewer.js";
import { MEANING, trouble } from "./page.js";

const { run, a, b } = byId("main").dataset,
  host = byId("side");

// Phase of a frame: which beat, and how far from one peak to the next. Without beats it is the time.
class Clock {
  constructor(data, byPhase) {
    this.time = data.time;
    this.peaks = byPhase ? data.beats.filter((beat) => !beat.left_out).map((beat) => data.time[beat.peak]) : [];
    this.period = this.peaks.length > 1 ? (this.peaks.at(-1) - this.peaks[0]) / (this.peaks.length - 1) : null;
    this.known = this.peaks.length > 0;
  }

  phase(time) {
    if (!this.known) return time;
    const { peaks } = this,
      i = peaks.findLastIndex((peak) => peak <= time),
      period = this.period ?? this.time.at(-1) - this.time[0];
    if (i < 0) return (time - peaks[0]) / period;
    const until = peaks[i + 1];
    return i + (time - peaks[i]) / (until === undefined ? period : until - peaks[i]);
  }

  at(phase) {
    if (!this.known) return phase;
    const { peaks } = this,
      i = Math.max(0, Math.min(peaks.length - 1, Math.floor(phase))),
      period = this.period ?? this.time.at(-1) - this.time[0];
    const until = peaks[i + 1];
    return peaks[i] + (phase - i) * (phase < 0 || until === undefined ? period : until - peaks[i]);
  }
}

async function start() {
  const info = await get(ofRun(run));
  byId("crumb-run").textContent = info.title;
  const measured = info.movies.filter((movie) => movie.state === "done");
  const choice = (id, label, chosen) => {
    const select = make(
      "select",
      { id },
      ...(measured.some((movie) => movie.key === chosen) ? [] : [make("option", { value: "" }, "Choose a movie")]),
      ...measured.map((movie) => make("option", { value: movie.key, selected: movie.key === chosen }, movie.movie)),
    );
    select.addEventListener("change", () =>
      location.assign(
        `${pageOf(run)}/side?a=${encodeURIComponent(byId("choose-a").value)}&b=${encodeURIComponent(
          byId("choose-b").value,
        )}`,
      ),
    );
    return make("label", {}, `${label} `, select);
  };
  const body = make("div");
  const step = make(
    "select",
    { id: "step" },
    make("option", { value: "phase" }, "by the beat"),
    make("option", { value: "time" }, "by time"),
  );
  host.replaceChildren(
    make(
      "div",
      { class: "controls" },
      choice("choose-a", "Left", a),
      choice("choose-b", "Right", b),
      make("label", {}, "In step ", step),
    ),
    body,
  );
  if (measured.length < 2) {
    body.append(make("p", { class: "reason" }, "Two measured movies are needed. Start the run first."));
    return;
  }
  const chosen = [a, b].map((key) => measured.find((movie) => movie.key === key));
  if (chosen.includes(undefined)) {
    body.append(make("p", { class: "reason" }, "Choose two movies above."));
    return;
  }
  body.append(make("p", { class: "note", role: "status" }, "Reading …"));
  const parts = await Promise.all(
    chosen.map(async (movie) => {
      const [about, data] = await Promise.all([get(ofMovie(run, movie.key)), get(`${ofMovie(run, movie.key)}/traces`)]);
      return { movie, about, data, state: new State({ frame: 0 }) };
    }),
  );
  show(body, parts, step, info.metrics ?? []);
}

function show(body, parts, step, metrics) {
  const columns = parts.map(({ movie, about, state }) => {
    const box = make("div", {}, make("h2", {}, make("a", { href: pageOf(run, movie.key) }, movie.movie)));
    return [
      box,
      new Viewer(box, {
        base: ofMovie(run, movie.key),
        info: about.info,
        label: `Movie ${movie.movie}. Space plays both, arrow keys step.`,
        state,
      }),
    ];
  });
  const traces = make("div", { class: "traces" });
  body.replaceChildren(
    make("div", { class: "beside even" }, ...columns.map(([box]) => box)),
    traces,
    numbers(parts, metrics),
  );
  let clocks,
    leading = false;
  const range = new State({ low: null, high: null }),
    charts = [];
  const follow = (from) => {
    if (leading) return;
    leading = true;
    const to = 1 - from,
      phase = clocks[from].phase(parts[from].data.time[parts[from].state.values.frame]);
    parts[to].state.set({ frame: nearest(parts[to].data.time, clocks[to].at(phase)) });
    leading = false;
    for (const chart of charts) chart.moveCursor();
  };
  parts.forEach(({ state }, i) =>
    state.listen((changed) => {
      if (changed.has("frame")) follow(i);
    }),
  );
  // Playing one plays both; the other one only follows.
  columns.forEach(([, viewer], i) => viewer.play.addEventListener("click", () => columns[1 - i][1].stop()));
  const renew = () => {
    const byPhase = step.value === "phase" && parts.every(({ data }) => data.beats.some((beat) => !beat.left_out));
    clocks = parts.map(({ data }) => new Clock(data, byPhase));
    charts.length = 0;
    traces.replaceChildren();
    const unit = byPhase ? "beats" : parts[0].data.time_unit;
    const ids = parts[0].data.signals
      .map((one) => one.id)
      .filter((id) => parts[1].data.signals.some((one) => one.id === id));
    for (const id of ids) {
      const signals = parts.map(({ data }) => data.signals.find((one) => one.id === id));
      if (signals[0].unit !== signals[1].unit) continue;
      const lines = signals.flatMap((signal, i) =>
        signal.lines.map((line, n) => ({
          ...line,
          cut: n > 0,
          colour: i + 1,
          name: signal.lines.length > 1 ? `${parts[i].movie.movie}, ${line.name}` : parts[i].movie.movie,
          x: parts[i].data.time.map((time) => clocks[i].phase(time)),
        })),
      );
      const { time } = parts[0].data;
      charts.push(
        new Chart(traces, {
          range,
          id,
          title: signals[0].title,
          unit: signals[0].unit,
          lines,
          xUnit: unit,
          xLabel: byPhase ? "beats, from peak to peak" : `time, ${unit}`,
          step: (clocks[0].phase(time.at(-1)) - clocks[0].phase(time[0])) / Math.max(1, time.length - 1),
          cursor: () => clocks[0].phase(time[parts[0].state.values.frame]),
          pick: (x) => parts[0].state.set({ frame: nearest(time, clocks[0].at(x)) }),
          where: (x) => `${written(x, 3)} ${unit}`,
        }),
      );
    }
    range.set({ low: null, high: null });
    follow(0);
  };
  step.addEventListener("change", renew);
  renew();
  parts[0].state.set({ frame: parts[0].data.beats[0]?.peak ?? 0 });
}

function numbers(parts, metrics) {
  const row = (one) => {
    const [first, second] = parts.map(({ movie }) => movie.metrics?.[one.column] ?? null);
    const cells = parts.map(({ movie }) =>
      make("td", {}, withError(movie.metrics?.[one.column] ?? null, movie.se?.[one.column])),
    );
    const change =
      first === null || second === null || first === 0
        ? "–"
        : `${((second / first - 1) * 100).toFixed(1)} %`.replace("-", "−");
    return make(
      "tr",
      {},
      make("th", { scope: "row" }, one.label, " ", make("span", { class: "unit" }, one.unit ?? "")),
      ...cells,
      make("td", {}, change),
    );
  };
  return make(
    "div",
    { class: "scroll", tabindex: "0", role: "region", "aria-label": "Key numbers" },
    make(
      "table",
      {},
      make("caption", {}, MEANING),
      make(
        "thead",
        {},
        make(
          "tr",
          {},
          make("th", { scope: "col" }, "Metric"),
          ...parts.map(({ movie }) => make("th", { scope: "col" }, movie.movie)),
          make("th", { scope: "col" }, "Right against left"),
        ),
      ),
      make("tbody", {}, ...metrics.map(row)),
    ),
  );
}

start().catch(trouble);
