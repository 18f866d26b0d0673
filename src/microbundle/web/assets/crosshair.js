// A cross that the arrow keys move over a picture, so that everything a mouse does there can be done by keys.

import { draw } from "./shared.js";
import { say, soon } from "./page.js";

export class Crosshair {
  // `act(point)` is what space does; `keys` are others, by name.
  constructor(viewer, act, keys = {}) {
    const { rows, cols } = viewer.info;
    Object.assign(this, { viewer, act, keys, at: [Math.round(rows / 2), Math.round(cols / 2)], on: false });
    this.shape = draw("path", { class: "crosshair", visibility: "hidden" });
    this.tell = soon(400, () => say(`row ${Math.round(this.at[0])}, column ${Math.round(this.at[1])}`));
    this.listen = (event) => this.key(event);
    this.hide = () => this.shape.setAttribute("visibility", "hidden");
  }

  start() {
    this.viewer.over.append(this.shape);
    this.viewer.stage.addEventListener("keydown", this.listen, true);
    this.viewer.stage.addEventListener("pointerdown", this.hide);
    this.viewer.stage.addEventListener("blur", this.hide);
  }

  stop() {
    this.shape.remove();
    this.viewer.stage.removeEventListener("keydown", this.listen, true);
    this.viewer.stage.removeEventListener("pointerdown", this.hide);
    this.viewer.stage.removeEventListener("blur", this.hide);
  }

  key(event) {
    if (event.target !== this.viewer.stage) return;
    const by = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
    if (by) {
      const size = event.shiftKey ? 10 : 1;
      this.at = this.viewer.inside([this.at[0] + size * by[0], this.at[1] + size * by[1]]);
      this.moved?.(this.at);
      this.tell();
    } else if (event.key === " ") this.act([...this.at]);
    else if (this.keys[event.key]) this.keys[event.key]();
    else return;
    event.preventDefault();
    event.stopPropagation();
    this.render();
  }

  render() {
    const [y, x] = [this.at[0] + 0.5, this.at[1] + 0.5],
      arm = 14 / this.viewer.scale,
      free = 3 / this.viewer.scale;
    this.shape.setAttribute(
      "d",
      `M${x - arm} ${y}H${x - free}M${x + free} ${y}H${x + arm}` +
        `M${x} ${y - arm}V${y - free}M${x} ${y + free}V${y + arm}`,
    );
    this.shape.setAttribute("visibility", "visible");
  }
}
