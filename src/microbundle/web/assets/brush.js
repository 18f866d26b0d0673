// Painting and erasing with a round brush.

import { Crosshair } from "./crosshair.js";
import { draw } from "./shared.js";
import { say } from "./page.js";

export class BrushTool {
  constructor(editor, value) {
    Object.assign(this, { editor, value });
    this.ring = draw("circle", { class: "brush", visibility: "hidden" });
    this.cross = new Crosshair(editor.viewer, (at) => {
      this.begin(at);
      this.end();
    });
    this.cross.moved = (at) => this.show(at);
    this.down = (event) => {
      if (event.button !== 0 || !this.editor.raster()) return;
      event.preventDefault();
      this.editor.viewer.stage.focus({ preventScroll: true });
      this.editor.viewer.stage.setPointerCapture(event.pointerId);
      this.begin(this.editor.viewer.place(event));
    };
    this.move = (event) => {
      const at = this.editor.viewer.place(event);
      this.show(at);
      if (this.raster) this.to(at);
    };
    this.up = () => this.end();
    this.leave = () => this.ring.setAttribute("visibility", "hidden");
  }

  get radius() {
    return this.editor.brushPx;
  }

  listeners(act) {
    const { stage } = this.editor.viewer;
    for (const [event, heard] of [
      ["pointerdown", this.down],
      ["pointermove", this.move],
      ["pointerup", this.up],
      ["pointercancel", this.up],
      ["pointerleave", this.leave],
    ])
      stage[act](event, heard);
  }

  start() {
    this.listeners("addEventListener");
    this.editor.viewer.over.append(this.ring);
    this.cross.start();
    say(`${this.value ? "Paint" : "Erase"}. Drag over the picture, or move the cross by arrow keys and press space.`);
  }

  stop() {
    this.end();
    this.listeners("removeEventListener");
    this.ring.remove();
    this.cross.stop();
  }

  show([row, col]) {
    for (const [key, value] of Object.entries({
      cx: col + 0.5,
      cy: row + 0.5,
      r: this.radius,
      visibility: "visible",
    })) {
      this.ring.setAttribute(key, value);
    }
  }

  begin(at) {
    this.raster = this.editor.raster()?.copy();
    this.last = at;
    if (this.raster) this.to(at);
  }

  to(at) {
    this.raster.stroke(this.last, at, this.radius, this.value);
    this.last = at;
    this.editor.tint(this.raster);
  }

  end() {
    const { raster } = this;
    this.raster = null;
    if (raster) this.editor.setMask(raster);
  }

  render() {}
}
