// Beats: which of them count, and where one lies, by hand. The program's own stay visible.

import { get } from "./api.js";
import { Chart, State, make, nearest } from "./shared.js";
import { Viewer } from "./viewer.js";
import { button, drafts, say, trouble } from "./page.js";

export async function startBeats(panel, movie) {
  const editor = new Beats(panel, movie);
  await editor.load();
  return { refresh: () => editor.load() };
}

class Beats {
  constructor(panel, movie) {
    Object.assign(this, { panel, movie, marks: {}, draftKey: `beats ${movie.run} ${movie.key}` });
    this.marks = drafts.get(this.draftKey) ?? {};
  }

  async load() {
    if (!this.movie.measured) {
      this.panel.replaceChildren(
        make("p", { class: "reason" }, "Beats are found when the movie is measured. Start the run first."),
      );
      this.chart = null;
      return;
    }
    this.data = await get(`${this.movie.base}/traces`);
    if (!this.chart) this.build();
    this.chart.beats = this.bands();
    this.chart.show(this.lines(), this.signal.title);
    this.list();
  }

  get signal() {
    return this.data.signals[0];
  }

  lines() {
    return this.signal.lines.map((line, i) => ({ ...line, x: this.data.time, colour: i + 1 }));
  }

  time(frame) {
    return this.data.time[Math.max(0, Math.min(this.data.time.length - 1, frame))];
  }

  bands() {
    return this.all()
      .filter((beat) => !beat.left_out)
      .map((beat) => ({
        from: this.time(beat.start),
        to: this.time(beat.stop),
        peak: this.time(beat.peak),
        complete: beat.complete,
      }));
  }

  // The beats of the result, with what is decided since.
  all() {
    const dropped = this.movie.decisions.filter((one) => one.kind === "drop_beat");
    const found = this.data.beats.map((beat) => ({
      ...beat,
      left_out: dropped.some((one) => one.peak_frame >= beat.start && one.peak_frame < beat.stop),
      by_hand: false,
    }));
    const own = this.movie.decisions
      .filter((one) => one.kind === "mark_beat")
      .map((one) => ({
        start: one.start_frame,
        peak: one.peak_frame,
        stop: one.stop_frame,
        complete: true,
        left_out: false,
        by_hand: true,
      }));
    const free = found.filter((beat) => !own.some((one) => one.start < beat.stop && beat.start < one.stop));
    return [...free, ...own].sort((a, b) => a.start - b.start);
  }

  build() {
    const left = make("div"),
      right = make("div", { class: "wide" });
    const state = this.movie.frame,
      range = new State({ low: null, high: null }),
      { time } = this.data;
    const step = time.length > 1 ? (time.at(-1) - time[0]) / (time.length - 1) : 1;
    this.setters = ["start", "peak", "stop"].map((name) => {
      const set = make("button", { type: "button" });
      set.addEventListener("click", () => this.mark({ [name]: state.values.frame }));
      return [name, set];
    });
    this.add = button("Add this beat", () => this.keepMark(), { class: "main" });
    this.clearMark = button("Clear", () => this.mark(null));
    this.told = make("p", { class: "note", role: "status" });
    this.rows = make("tbody");
    this.panel.replaceChildren(make("div", { class: "beside even" }, left, right));
    right.append(
      make("p", { class: "note" }, "Click a trace to go to a frame; drag to zoom. Keys on the trace: ← → + − 0."),
    );
    this.chart = new Chart(right, {
      range,
      id: "beats",
      height: 220,
      title: this.signal.title,
      unit: this.signal.unit,
      lines: this.lines(),
      beats: this.bands(),
      step,
      xLabel: this.data.time_unit === "s" ? "time, s" : "time, frames",
      xUnit: this.data.time_unit,
      cursor: () => this.time(state.values.frame),
      pick: (x) => state.set({ frame: nearest(this.data.time, x) }),
      where: (x) => `frame ${nearest(this.data.time, x)}, ${x.toFixed(3)} ${this.data.time_unit}`,
    });
    state.listen((changed) => {
      if (changed.has("frame")) this.chart.moveCursor();
    });
    right.append(
      make(
        "div",
        { class: "scroll" },
        make(
          "table",
          { class: "beats" },
          make("caption", {}, "Beats, in frames"),
          make(
            "thead",
            {},
            make(
              "tr",
              {},
              ...["Beat", "From", "Peak", "To", "Counts"].map((name) => make("th", { scope: "col" }, name)),
            ),
          ),
          this.rows,
        ),
      ),
      make("h2", {}, "Mark a beat by hand"),
      make(
        "p",
        { class: "note" },
        "Go to its first frame, to its peak, and to the first frame after " +
          "it, and press the button of each. It takes the place of what was found there.",
      ),
      make("p", { class: "choices" }, ...this.setters.map(([, one]) => one), this.add, this.clearMark),
      this.told,
    );
    new Viewer(left, {
      base: this.movie.base,
      info: this.movie.info,
      label: "Movie. Space plays, arrow keys step.",
      state,
    });
    this.mark({});
  }

  mark(change) {
    this.marks = change === null ? {} : { ...this.marks, ...change };
    drafts.set(this.draftKey, Object.keys(this.marks).length ? this.marks : null);
    const words = { start: "Starts here", peak: "Peak here", stop: "Ends here" };
    for (const [name, set] of this.setters)
      set.textContent = `${words[name]}${name in this.marks ? ` (${this.marks[name]})` : ""}`;
    const { start, peak, stop } = this.marks,
      all = [start, peak, stop].every((one) => one !== undefined);
    const fine = all && start < peak && peak < stop - 1;
    this.add.disabled = !fine;
    this.clearMark.hidden = !Object.keys(this.marks).length;
    this.told.textContent = all && !fine ? "The first frame, the peak and the end must follow each other." : "";
  }

  async keepMark() {
    const { start, peak, stop } = this.marks;
    await this.movie.save((decisions) => [
      ...decisions,
      { kind: "mark_beat", start_frame: start, peak_frame: peak, stop_frame: stop, ...this.movie.sign() },
    ]);
    this.mark(null);
    say("The beat is marked. Measure the movie again to use it.");
  }

  list() {
    const focused = document.activeElement?.dataset?.beat;
    this.rows.replaceChildren(
      ...this.all().map((beat, i) => {
        const name = `Beat ${i + 1}`,
          box = make("input", { type: "checkbox", "aria-label": `${name} counts` });
        box.checked = !beat.left_out;
        box.dataset.beat = beat.start;
        box.addEventListener("change", () => this.count(beat, box.checked));
        const go = button(name, () => this.movie.frame.set({ frame: beat.peak }), { class: "link" });
        return make(
          "tr",
          {},
          make("th", { scope: "row" }, go, beat.by_hand ? " by hand" : beat.complete ? "" : " cut off"),
          make("td", {}, beat.start),
          make("td", {}, beat.peak),
          make("td", {}, beat.stop),
          make("td", {}, beat.by_hand ? button("Take back", () => this.unmark(beat)) : box),
        );
      }),
    );
    if (focused) this.rows.querySelector(`[data-beat="${focused}"]`)?.focus();
  }

  async count(beat, counts) {
    const inside = (one) => one.kind === "drop_beat" && one.peak_frame >= beat.start && one.peak_frame < beat.stop;
    try {
      await this.movie.save((decisions) => [
        ...decisions.filter((one) => !inside(one)),
        ...(counts ? [] : [{ kind: "drop_beat", peak_frame: beat.peak, ...this.movie.sign() }]),
      ]);
      say(counts ? "The beat counts." : "The beat is left out. Measure the movie again to use this.");
    } catch (error) {
      this.list();
      trouble(error);
    }
  }

  async unmark(beat) {
    await this.movie.save((decisions) =>
      decisions.filter(
        (one) =>
          !(
            one.kind === "mark_beat" &&
            one.start_frame === beat.start &&
            one.peak_frame === beat.peak &&
            one.stop_frame === beat.stop
          ),
      ),
    );
  }
}
