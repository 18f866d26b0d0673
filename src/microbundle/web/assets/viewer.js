// A movie to look at: play, scrub, zoom, contrast, by mouse and by keys. Other modules draw in its layers.

import { Frames } from "./frames.js";
import { Contrast } from "./contrast.js";
import { State, draw, make } from "./shared.js";
import { button, trouble } from "./page.js";

const AHEAD = 16,
  WIDTHS = [256, 512, 768, 1024, 1536, 2048],
  TALLEST = 0.68,
  UNKNOWN_RATE = 25;
const SPEEDS = [
  [0.1, "1/10"],
  [0.25, "1/4"],
  [0.5, "1/2"],
  [1, "real"],
  [2, "2 ×"],
];
const ZOOMS = [1, 1.5, 2, 3, 4, 6, 8];

export class Viewer {
  // `base` is the address of frame and grey; `info`: frames, rows, cols, frames_per_s, time_s; `state` (frame) may be shared.
  constructor(host, { base, info, label, state = new State({ frame: 0 }), controls = true, tools = [] }) {
    Object.assign(this, { base, info, state, zoom: 1, playing: null, speed: 1, look: {}, shown: null });
    this.canvas = make("canvas", { width: info.cols, height: info.rows });
    this.tint = make("canvas", { width: info.cols, height: info.rows, class: "tint" });
    this.over = draw("svg", { class: "over", viewBox: `0 0 ${info.cols} ${info.rows}` });
    this.stage = make(
      "div",
      { class: "stage", tabindex: "0", role: "application", "aria-label": label },
      this.canvas,
      this.tint,
      this.over,
    );
    this.view = make("div", { class: "view" }, this.stage);
    this.root = make("div", { class: "viewer" }, this.view);
    host.append(this.root);
    this.frames = new Frames(
      (t) => this.address(t),
      (t) => this.arrived(t),
      trouble,
    );
    this.addPlayer(controls, tools);
    this.state.listen((changed) => {
      if (changed.has("frame")) this.render();
    });
    this.stage.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.resize()).observe(this.view);
    this.resize();
    this.render();
  }

  get last() {
    return Math.max(0, this.info.frames - 1);
  }

  get frame() {
    return this.state.values.frame;
  }

  address(t) {
    const asked = new URLSearchParams({ t, width: this.width });
    for (const [key, value] of Object.entries(this.look)) asked.set(key, value);
    return `${this.base}/frame?${asked}`;
  }

  when(t) {
    const { time_s: times, frames_per_s: rate } = this.info,
      at = times?.[t] ?? (rate ? t / rate : null);
    return `frame ${t}${at === null ? "" : `, ${at.toFixed(3)} s`}`;
  }

  // --- controls ----------------------------------------------------------------------------------------------------

  addPlayer(controls, tools) {
    this.play = make("button", { type: "button", "aria-label": "Play" }, "▶");
    this.play.addEventListener("click", () => this.toggle());
    this.slider = make("input", {
      type: "range",
      min: 0,
      max: this.last,
      value: this.frame,
      step: 1,
      "aria-label": "Frame",
    });
    this.slider.addEventListener("input", () => this.go(Number(this.slider.value)));
    this.slider.addEventListener("keydown", (event) => {
      if (event.key === " ") this.key(event);
    });
    this.told = make("output");
    if (controls) this.root.append(make("div", { class: "player" }, this.play, this.slider, this.told));
    const speed = make(
      "select",
      {},
      ...SPEEDS.map(([value, text]) => make("option", { value, selected: value === 1 }, text)),
    );
    speed.addEventListener("change", () => {
      this.speed = Number(speed.value);
      this.began = null;
    });
    this.contrast = new Contrast(this.base, (look) => {
      this.look = look;
      this.again();
    });
    const zoom = make(
      "span",
      { role: "group", "aria-label": "Zoom", class: "switch" },
      button("−", () => this.setZoom(-1), { "aria-label": "Zoom out" }),
      button("Fit", () => this.setZoom(0)),
      button("+", () => this.setZoom(1), { "aria-label": "Zoom in" }),
    );
    this.root.append(
      make("div", { class: "controls" }, ...(controls ? [make("label", {}, "Speed ", speed)] : []), zoom, ...tools),
      this.contrast.root,
    );
  }

  key(event) {
    if (event.defaultPrevented) return;
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by) this.go(this.frame + by * (event.shiftKey ? 10 : 1));
    else if (event.key === "Home") this.go(0);
    else if (event.key === "End") this.go(this.last);
    else if (event.key === " ") this.toggle();
    else if (event.key === "+" || event.key === "=") this.setZoom(1);
    else if (event.key === "-") this.setZoom(-1);
    else return;
    event.preventDefault();
  }

  go(t) {
    this.stop();
    this.state.set({ frame: Math.max(0, Math.min(this.last, t)) });
  }

  toggle() {
    if (this.playing !== null) {
      this.stop();
      return;
    }
    this.play.textContent = "❚❚";
    this.play.setAttribute("aria-label", "Pause");
    this.began = null;
    const step = (now) => {
      if (!this.view.clientWidth) {
        this.stop();
        return;
      }
      const rate = (this.info.frames_per_s ?? UNKNOWN_RATE) * this.speed;
      this.began ??= { now, frame: this.frame };
      const next = (this.began.frame + Math.floor(((now - this.began.now) / 1000) * rate)) % this.info.frames;
      // The clock waits for frames that are not there yet: every one is shown.
      if (this.frames.at(next)) this.state.set({ frame: next });
      else {
        this.frames.want(next, this.following(next));
        this.began = null;
        const after = (this.frame + 1) % this.info.frames;
        if (this.frames.at(after)) this.state.set({ frame: after });
      }
      this.playing = requestAnimationFrame(step);
    };
    this.playing = requestAnimationFrame(step);
  }

  stop() {
    if (this.playing === null) return;
    cancelAnimationFrame(this.playing);
    this.playing = null;
    this.play.textContent = "▶";
    this.play.setAttribute("aria-label", "Play");
  }

  // --- picture -----------------------------------------------------------------------------------------------------

  following(t) {
    return Array.from({ length: Math.min(AHEAD, this.last) }, (_, n) => (t + 1 + n) % this.info.frames);
  }

  render() {
    const t = this.frame;
    this.slider.value = t;
    this.slider.setAttribute("aria-valuetext", this.when(t));
    this.told.textContent = this.when(t);
    if (!this.width || !this.view.clientWidth) return; // Another tab is open: it is drawn when it is seen again.
    this.frames.want(t, this.playing === null ? [] : this.following(t));
    if (this.frames.at(t)) this.paint(t);
  }

  arrived(t) {
    if (t === this.frame || (this.shown !== null && Math.abs(t - this.frame) < Math.abs(this.shown - this.frame)))
      this.paint(t);
  }

  paint(t) {
    const bitmap = this.frames.at(t);
    if (this.canvas.width !== bitmap.width || this.canvas.height !== bitmap.height) {
      [this.canvas.width, this.canvas.height] = [bitmap.width, bitmap.height];
    }
    this.canvas.getContext("2d").drawImage(bitmap, 0, 0);
    this.shown = t;
    this.stage.dataset.frame = t;
    this.painted?.();
  }

  again() {
    this.frames.forget();
    this.shown = null;
    this.frames.want(this.frame);
  }

  // --- size --------------------------------------------------------------------------------------------------------

  setZoom(by) {
    const i = ZOOMS.indexOf(this.zoom),
      middle = [
        (this.view.scrollLeft + this.view.clientWidth / 2) / this.stage.clientWidth,
        (this.view.scrollTop + this.view.clientHeight / 2) / this.stage.clientHeight,
      ];
    this.zoom = by === 0 ? 1 : ZOOMS[Math.max(0, Math.min(ZOOMS.length - 1, i + by))];
    this.resize();
    this.view.scrollLeft = middle[0] * this.stage.clientWidth - this.view.clientWidth / 2;
    this.view.scrollTop = middle[1] * this.stage.clientHeight - this.view.clientHeight / 2;
  }

  resize() {
    const { rows, cols } = this.info,
      room = this.view.clientWidth;
    if (!room) return;
    const fit = Math.min(room, (innerHeight * TALLEST * cols) / rows),
      size = Math.round(fit * this.zoom);
    this.view.style.maxHeight = `${Math.ceil((fit * rows) / cols) + 2}px`;
    this.stage.style.width = size === Math.round(room) ? "100%" : `${size}px`;
    this.stage.style.aspectRatio = `${cols} / ${rows}`;
    this.scale = size / cols; // Screen pixels for one of the movie's.
    const wished = size * Math.min(2, devicePixelRatio || 1);
    const width = Math.min(cols, WIDTHS.find((one) => one >= wished) ?? cols);
    if (width !== this.width) {
      this.width = width;
      this.again();
    }
    this.render();
    this.resized?.();
  }

  // Row and column under the pointer; whole numbers are the middles of pixels.
  place(event) {
    const box = this.stage.getBoundingClientRect();
    return [
      ((event.clientY - box.top) / box.height) * this.info.rows - 0.5,
      ((event.clientX - box.left) / box.width) * this.info.cols - 0.5,
    ];
  }

  inside([row, col]) {
    return [Math.max(0, Math.min(this.info.rows - 1, row)), Math.max(0, Math.min(this.info.cols - 1, col))];
  }
}
