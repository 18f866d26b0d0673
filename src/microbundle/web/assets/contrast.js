// Contrast: two limits over the histogram of the movie's grey values. Only what is shown changes, never the movie.

import { get } from "./api.js";
import { draw, make } from "./shared.js";
import { button, soon, trouble } from "./page.js";

const STEPS = 500;

export class Contrast {
  constructor(base, changed) {
    this.changed = soon(60, changed);
    this.shape = draw("path");
    this.sliders = ["Darkest", "Brightest"].map((name) =>
      make("input", { type: "range", min: 0, max: STEPS, disabled: true, "aria-label": `${name} shown` }),
    );
    this.told = make("output");
    this.root = make(
      "details",
      { class: "contrast" },
      make("summary", {}, "Contrast"),
      make(
        "div",
        { class: "histogram" },
        draw("svg", { viewBox: "0 0 100 30", preserveAspectRatio: "none", "aria-hidden": "true" }, this.shape),
        ...this.sliders,
      ),
      make(
        "p",
        { class: "choices" },
        button("By itself", () => this.reset()),
        this.told,
      ),
      make("p", { class: "note" }, "Changes only what you see. Measured are always the movie’s own grey values."),
    );
    this.root.addEventListener("toggle", () => {
      if (this.root.open && !this.grey) this.start(base).catch(trouble);
    });
    for (const slider of this.sliders) slider.addEventListener("input", () => this.move(slider));
  }

  async start(base) {
    this.grey = await get(`${base}/grey`);
    const { histogram } = this.grey,
      most = Math.max(1, ...histogram);
    this.shape.setAttribute(
      "d",
      `M0 30${histogram
        .map(
          (n, i) =>
            `L${((100 * (i + 0.5)) / histogram.length).toFixed(2)} ${(30 - 29 * Math.sqrt(n / most)).toFixed(2)}`,
        )
        .join("")}L100 30Z`,
    );
    this.show([this.grey.low, this.grey.high]);
  }

  show(limits) {
    const { min, max } = this.grey;
    for (const slider of this.sliders) slider.disabled = false;
    this.sliders.forEach((slider, i) => {
      slider.value = ((limits[i] - min) / (max - min || 1)) * STEPS;
    });
    this.tell(limits);
  }

  tell(limits) {
    this.told.textContent = `${limits.map((one) => Number(one.toPrecision(4))).join(" to ")}`;
    this.sliders.forEach((slider, i) => slider.setAttribute("aria-valuetext", `${Number(limits[i].toPrecision(4))}`));
  }

  move(slider) {
    const { min, max } = this.grey,
      [low, high] = this.sliders;
    if (Number(low.value) >= Number(high.value))
      slider.value = slider === low ? Number(high.value) - 1 : Number(low.value) + 1;
    const limits = this.sliders.map((one) => min + (Number(one.value) / STEPS) * (max - min));
    this.tell(limits);
    this.changed({ low: limits[0], high: limits[1] });
  }

  reset() {
    if (!this.grey) return;
    this.show([this.grey.low, this.grey.high]);
    this.changed({});
  }
}
