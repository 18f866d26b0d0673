// The tissue's long axis: a line with two handles that turn it.

import { drag } from "./drag.js";
import { draw } from "./shared.js";
import { say } from "./page.js";

const STEP_DEG = 0.5,
  LARGE_DEG = 5;

// Into (-90, 90], as the tissue's axis is told.
export const turned = (degrees) => {
  const at = ((((degrees + 90) % 180) + 180) % 180) - 90;
  return at === -90 ? 90 : at;
};

export function axisEnds({ center, angle_deg: angle, length_px: length }) {
  const half = 0.56 * length,
    by = [Math.sin((angle * Math.PI) / 180) * half, Math.cos((angle * Math.PI) / 180) * half];
  return [-1, 1].map((side) => [center[0] + side * by[0], center[1] + side * by[1]]);
}

export class AxisTool {
  constructor(editor) {
    this.editor = editor;
    this.layer = draw("g", { class: "handles" });
  }

  start() {
    this.editor.viewer.over.append(this.layer);
    this.render();
    say("Axis. Drag an end, or tab to it and press the arrow keys.");
  }

  stop() {
    this.layer.remove();
  }

  render() {
    if (this.dragging) return;
    const { axis } = this.editor;
    const focused = [...this.layer.querySelectorAll(".handle")].indexOf(document.activeElement);
    this.layer.replaceChildren();
    if (!axis) return;
    this.angle = axis.angle_deg;
    this.paint(axis);
    this.handles[focused]?.focus();
  }

  paint(axis) {
    const ends = axisEnds({ ...axis, angle_deg: this.angle }),
      size = 8 / this.editor.viewer.scale;
    if (!this.layer.children.length) {
      this.line = draw("path", { class: "own" });
      this.handles = ends.map((_, i) => {
        const handle = draw("circle", {
          class: "handle corner",
          r: size,
          tabindex: "0",
          role: "slider",
          "aria-valuemin": -90,
          "aria-valuemax": 90,
          "aria-label": i ? "Right end of the axis" : "Left end of the axis",
        });
        handle.addEventListener("pointerdown", (event) => this.drag(event, axis, i));
        handle.addEventListener("keydown", (event) => this.key(event));
        return handle;
      });
      this.layer.append(this.line, ...this.handles);
    }
    this.line.setAttribute("d", `M${ends.map(([row, col]) => `${col + 0.5} ${row + 0.5}`).join("L")}`);
    ends.forEach(([row, col], i) => {
      this.handles[i].setAttribute("cx", col + 0.5);
      this.handles[i].setAttribute("cy", row + 0.5);
      this.handles[i].setAttribute("aria-valuenow", this.angle.toFixed(1));
      this.handles[i].setAttribute("aria-valuetext", `${this.angle.toFixed(1)} degrees`);
    });
  }

  drag(event, axis, i) {
    this.dragging = true;
    this.handles[i].focus();
    const turn = (angle) => {
      this.angle = angle;
      this.paint(axis);
      this.editor.tellAngle(angle);
    };
    drag(
      event,
      (moved) => {
        const [row, col] = this.editor.viewer.place(moved);
        turn(turned((Math.atan2(row - axis.center[0], col - axis.center[1]) * 180) / Math.PI));
      },
      (completed) => {
        this.dragging = false;
        if (completed) this.editor.setAxis(Number(this.angle.toFixed(2)));
        else turn(axis.angle_deg);
      },
    );
  }

  key(event) {
    const by = { ArrowUp: -1, ArrowLeft: -1, ArrowDown: 1, ArrowRight: 1 }[event.key];
    if (!by) return;
    event.preventDefault();
    event.stopPropagation();
    this.angle = turned(this.angle + by * (event.shiftKey ? LARGE_DEG : STEP_DEG));
    this.paint(this.editor.axis);
    this.editor.setAxis(Number(this.angle.toFixed(2)));
  }
}
