// A new outline, corner by corner. Double click, Enter or the first corner close it; Escape gives it up.

import { Crosshair } from "./crosshair.js";
import { Raster } from "./raster.js";
import { ringPath } from "./outline.js";
import { draw } from "./shared.js";
import { say } from "./page.js";

const NEAR = 9;

export class DrawTool {
  constructor(editor) {
    this.editor = editor;
    this.points = [];
    this.layer = draw("g", { class: "corners", "pointer-events": "none" });
    this.cross = new Crosshair(editor.viewer, (at) => this.add(at), {
      Enter: () => this.close(),
      Escape: () => this.clear(),
      Backspace: () => this.back(),
    });
    this.cross.moved = (at) => this.paint(at);
    this.down = (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      this.editor.viewer.stage.focus({ preventScroll: true });
      this.add(this.editor.viewer.inside(this.editor.viewer.place(event)));
    };
    this.move = (event) => this.paint(this.editor.viewer.place(event));
    this.twice = () => this.close();
  }

  start() {
    const { stage, over } = this.editor.viewer;
    over.append(this.layer);
    stage.addEventListener("pointerdown", this.down);
    stage.addEventListener("pointermove", this.move);
    stage.addEventListener("dblclick", this.twice);
    this.cross.start();
    this.clear();
    say("Draw. Click corner after corner; double click or Enter closes the outline.");
  }

  stop() {
    const { stage } = this.editor.viewer;
    this.layer.remove();
    stage.removeEventListener("pointerdown", this.down);
    stage.removeEventListener("pointermove", this.move);
    stage.removeEventListener("dblclick", this.twice);
    this.cross.stop();
  }

  clear() {
    this.points = [];
    this.paint();
  }

  back() {
    this.points.pop();
    this.paint();
  }

  add(at) {
    const near = (point) => Math.hypot(point[0] - at[0], point[1] - at[1]) * this.editor.viewer.scale < NEAR;
    if (this.points.length > 2 && near(this.points[0])) this.close();
    else if (!this.points.length || !near(this.points.at(-1))) {
      this.points.push(at);
      this.paint();
      say(`corner ${this.points.length}`);
    }
  }

  close() {
    if (this.points.length < 3) {
      say("An outline needs three corners or more.");
      return;
    }
    const { rows, cols } = this.editor.viewer.info,
      made = Raster.fromRings([this.points], rows, cols);
    this.points = [];
    this.paint();
    this.editor.setMask(made);
    say("The outline is closed.");
  }

  paint(to) {
    const size = 5 / this.editor.viewer.scale,
      line = to && this.points.length ? [...this.points, to] : this.points;
    this.layer.replaceChildren(
      draw("path", { class: "own open", d: ringPath([line]).replace("Z", "") }),
      ...this.points.map(([row, col]) => draw("circle", { class: "corner", cx: col + 0.5, cy: row + 0.5, r: size })),
    );
  }

  render() {
    this.paint();
  }
}
