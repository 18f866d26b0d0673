// Two minutes of clicking: the same spots of the tissue in a few frames by hand, and how well the tracks agree.

import { get, post } from "./api.js";
import { Crosshair } from "./crosshair.js";
import { State, draw, make, written } from "./shared.js";
import { Viewer } from "./viewer.js";
import { does, drafts, say } from "./page.js";

const POINTS = 4,
  FRAMES = 4,
  LOUPE = 4;

export async function startVerify(panel, movie) {
  const verify = new Verify(panel, movie);
  await verify.start();
  return { refresh: () => verify.start() };
}

class Verify {
  constructor(panel, movie) {
    Object.assign(this, { panel, movie, draftKey: `clicks ${movie.run} ${movie.key}` });
  }

  async start() {
    if (this.viewer) return;
    if (!this.movie.measured) {
      this.panel.replaceChildren(
        make("p", { class: "reason" }, "There are no tracks yet to compare with. Measure the movie first."),
      );
      return;
    }
    this.data = await get(`${this.movie.base}/traces`);
    this.frames = this.chosenFrames();
    this.clicks = drafts.get(this.draftKey) ?? [];
    this.at = 0;
    this.state = new State({ frame: this.frames[0] });
    this.build();
    this.goTo(this.firstOpen());
  }

  // At rest, then at times of much motion, spread over the first beat.
  chosenFrames() {
    const last = this.data.time.length - 1,
      beat = this.data.beats.find((one) => one.complete) ?? this.data.beats[0];
    if (!beat) return [...new Set(Array.from({ length: FRAMES }, (_, i) => Math.round((i * last) / (FRAMES - 1))))];
    const { start, peak, stop } = beat,
      between = (a, b) => Math.round((a + b) / 2);
    return [...new Set([start, between(start, peak), peak, between(peak, stop)])].map((frame) => Math.min(last, frame));
  }

  build() {
    const left = make("div");
    this.step = make("h2");
    this.task = make("p", { role: "status" });
    this.loupe = make("canvas", { width: 200, height: 200, class: "loupe", "aria-hidden": "true" });
    this.steps = make("ol", { class: "steps" });
    this.back = make("button", { type: "button" }, "Take the last click back");
    this.back.addEventListener("click", () => this.undo());
    this.again = make("button", { type: "button" }, "Begin again");
    this.again.addEventListener("click", () => {
      this.clicks = [];
      this.keep();
      this.goTo(0);
    });
    this.compare = make("button", { type: "button", class: "main" }, "Compare with the tracks");
    this.compare.addEventListener("click", () => does(this.compare, () => this.ask()));
    this.answer = make("div", { role: "status", class: "agreement" });
    this.panel.replaceChildren(
      make(
        "div",
        { class: "beside" },
        left,
        make(
          "div",
          { class: "side" },
          this.step,
          this.task,
          this.loupe,
          this.steps,
          make("p", { class: "choices" }, this.compare),
          make("p", { class: "choices" }, this.back, this.again),
          this.answer,
        ),
      ),
    );
    this.viewer = new Viewer(left, {
      base: this.movie.base,
      info: this.movie.info,
      label: "Picture to click points in",
      state: this.state,
      controls: false,
    });
    this.viewer.root.dataset.tool = "click";
    this.layer = draw("g", { class: "clicks" });
    this.viewer.over.append(this.layer);
    this.viewer.resized = () => this.show();
    this.cross = new Crosshair(this.viewer, (at) => this.click(at), { Backspace: () => this.undo() });
    this.cross.moved = (at) => this.magnify(at);
    this.cross.start();
    this.viewer.painted = () => this.magnify(this.pointed ?? this.cross.at);
    this.viewer.stage.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      this.viewer.stage.focus({ preventScroll: true });
      this.click(this.viewer.place(event));
    });
    this.viewer.stage.addEventListener("pointermove", (event) => {
      this.pointed = this.viewer.place(event);
      this.magnify(this.pointed);
    });
  }

  ofFrame(frame) {
    return this.clicks.filter((one) => one.frame === frame);
  }

  firstOpen() {
    const open = this.frames.findIndex((frame) => this.ofFrame(frame).length < POINTS);
    return open < 0 ? this.frames.length - 1 : open;
  }

  goTo(at) {
    this.at = at;
    this.state.set({ frame: this.frames[at] });
    this.show();
  }

  click(at) {
    const frame = this.frames[this.at],
      done = this.ofFrame(frame).map((one) => one.point);
    const point = Array.from({ length: POINTS }, (_, i) => i + 1).find((one) => !done.includes(one));
    if (!point) return;
    const [row, col] = this.viewer.inside(at);
    this.clicks.push({ point, frame, row: Math.round(100 * row) / 100, col: Math.round(100 * col) / 100 });
    this.keep();
    if (point === POINTS && this.at < this.frames.length - 1) this.goTo(this.at + 1);
    else this.show();
  }

  undo() {
    const last = this.clicks.pop();
    this.keep();
    if (last) this.goTo(this.frames.indexOf(last.frame));
  }

  keep() {
    drafts.set(this.draftKey, this.clicks.length ? this.clicks : null);
    this.answer.replaceChildren();
  }

  show() {
    const frame = this.frames[this.at],
      here = this.ofFrame(frame),
      whole = this.clicks.length >= POINTS * this.frames.length;
    this.step.textContent = `Frame ${this.at + 1} of ${this.frames.length}`;
    this.task.textContent = whole
      ? "All points are clicked. Compare them with the tracks."
      : this.at === 0
        ? `Click ${POINTS} spots of the tissue that you would know again, spread over it: ${here.length} of ${POINTS}.`
        : `Click spot ${here.length + 1} again. Rings show where you clicked it before.`;
    this.compare.disabled = this.frames.filter((one) => this.ofFrame(one).length).length < 2;
    this.back.disabled = !this.clicks.length;
    this.again.disabled = !this.clicks.length;
    this.steps.replaceChildren(
      ...this.frames.map((one, i) => {
        const go = make("button", { type: "button", "aria-current": i === this.at ? "step" : null }, `Frame ${one}`);
        go.addEventListener("click", () => this.goTo(i));
        return make("li", {}, go, ` ${this.ofFrame(one).length} of ${POINTS}`);
      }),
    );
    const before = this.at > 0 ? this.ofFrame(this.frames[0]) : [],
      size = 1 / this.viewer.scale;
    const next = here.length + 1;
    this.layer.replaceChildren(
      ...before.map((one) =>
        draw("circle", {
          class: `before${one.point === next ? " next" : ""}`,
          cx: one.col + 0.5,
          cy: one.row + 0.5,
          r: 9 * size,
        }),
      ),
      ...[...before.filter((one) => !here.some((other) => other.point === one.point)), ...here].map((one) =>
        draw("text", { x: one.col + 0.5 + 9 * size, y: one.row + 0.5 - 9 * size, "font-size": 14 * size }, one.point),
      ),
      ...here.map(({ row, col }) =>
        draw("path", {
          class: "spot",
          d: `M${col + 0.5 - 6 * size} ${row + 0.5}h${12 * size}M${col + 0.5} ${row + 0.5 - 6 * size}v${12 * size}`,
        }),
      ),
    );
  }

  // The surroundings of the pointer, several times as large.
  magnify([row, col]) {
    const context = this.loupe.getContext("2d"),
      { canvas, info } = this.viewer,
      scale = canvas.width / info.cols;
    const half = this.loupe.width / (2 * LOUPE * this.viewer.scale);
    context.imageSmoothingEnabled = false;
    context.fillStyle = "#000";
    context.fillRect(0, 0, 200, 200);
    context.drawImage(
      canvas,
      (col + 0.5 - half) * scale,
      (row + 0.5 - half) * scale,
      2 * half * scale,
      2 * half * scale,
      0,
      0,
      200,
      200,
    );
    context.strokeStyle = "#ffe14d";
    context.strokeRect(100, 0, 0, 88);
    context.strokeRect(100, 112, 0, 88);
    context.strokeRect(0, 100, 88, 0);
    context.strokeRect(112, 100, 88, 0);
  }

  async ask() {
    const told = await post(`${this.movie.base}/clicks`, { points: this.clicks });
    const rows = told.points.map((one) =>
      make(
        "tr",
        {},
        make("th", { scope: "row" }, `Spot ${one.point}`),
        make("td", {}, `${written(one.difference_px, 3)} px`),
        make("td", {}, one.difference_um ? `${written(one.difference_um, 3)} µm` : "–"),
      ),
    );
    this.answer.replaceChildren(
      make("p", { class: `verdict ${told.agrees ? "pass" : "review"}` }, make("span", {}, told.verdict)),
      make(
        "table",
        {},
        make("caption", {}, "Mean distance between your clicks and the tracks"),
        make("thead", {}, make("tr", {}, ...["Spot", "px", "µm"].map((name) => make("th", { scope: "col" }, name)))),
        make("tbody", {}, ...rows),
      ),
    );
    say(told.verdict);
  }
}
