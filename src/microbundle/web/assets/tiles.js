// The rectangle that is divided into sub-domains: moved as a whole or by its sides, in the tissue's axes.

import { drag } from "./drag.js";
import { ringPath } from "./outline.js";
import { draw } from "./shared.js";
import { say } from "./page.js";

const LEAST_PX = 10;
const SIDES = ["upper side", "lower side", "left side", "right side"];

// Turning about the tissue's centre, as the settings count it.
export function toImage([row, col], { center, direction: [dr, dc] }) {
  const r = row - center[0],
    c = col - center[1];
  return [center[0] + r * dc + c * dr, center[1] - r * dr + c * dc];
}

export function toTissue([row, col], { center, direction: [dr, dc] }) {
  const r = row - center[0],
    c = col - center[1];
  return [center[0] + r * dc - c * dr, center[1] + r * dr + c * dc];
}

export class TilesTool {
  constructor(editor) {
    this.editor = editor;
    this.layer = draw("g", { class: "handles" });
  }

  start() {
    this.editor.viewer.over.append(this.layer);
    this.render();
    say("Sub-domains. Drag the rectangle or its sides, or tab to them and press the arrow keys.");
  }

  stop() {
    this.layer.remove();
  }

  render() {
    if (this.dragging) return;
    const focused = [...this.layer.querySelectorAll("[tabindex]")].indexOf(document.activeElement);
    this.layer.replaceChildren();
    const { axis, extents } = this.editor;
    if (!axis || !extents) return;
    this.extents = [...extents];
    this.axis = axis;
    this.paint();
    [...this.layer.querySelectorAll("[tabindex]")][focused]?.focus();
  }

  paint() {
    const [r0, r1, c0, c1] = this.extents,
      place = (row, col) => toImage([row, col], this.axis),
      size = 8 / this.editor.viewer.scale;
    const spots = [
      [r0, (c0 + c1) / 2],
      [r1, (c0 + c1) / 2],
      [(r0 + r1) / 2, c0],
      [(r0 + r1) / 2, c1],
    ];
    if (!this.layer.children.length) {
      this.box = draw("path", {
        class: "own box",
        tabindex: "0",
        role: "button",
        "aria-label": "Whole rectangle; arrow keys move it",
      });
      this.box.addEventListener("pointerdown", (event) => this.drag(event, [0, 1, 2, 3]));
      this.box.addEventListener("keydown", (event) => this.key(event, [0, 1, 2, 3]));
      this.handles = SIDES.map((name, i) => {
        const handle = draw("circle", {
          class: "handle corner",
          r: size,
          tabindex: "0",
          role: "button",
          "aria-label": `${name}; arrow keys move it`,
        });
        handle.addEventListener("pointerdown", (event) => this.drag(event, [i]));
        handle.addEventListener("keydown", (event) => this.key(event, [i]));
        return handle;
      });
      this.layer.append(this.box, ...this.handles);
    }
    this.box.setAttribute("d", ringPath([[place(r0, c0), place(r0, c1), place(r1, c1), place(r1, c0)]]));
    spots.forEach((spot, i) => {
      const [row, col] = place(...spot);
      this.handles[i].setAttribute("cx", col + 0.5);
      this.handles[i].setAttribute("cy", row + 0.5);
    });
  }

  // Moves some of the sides by a distance across and along the tissue; a rectangle keeps a least size.
  moved(start, which, [down, right]) {
    const out = [...start];
    for (const i of which) out[i] += i < 2 ? down : right;
    if (which.length === 1) {
      const [i] = which,
        other = out[i ^ 1];
      out[i] = i % 2 ? Math.max(out[i], other + LEAST_PX) : Math.min(out[i], other - LEAST_PX);
    }
    return out.map((one) => Math.round(10 * one) / 10);
  }

  drag(event, which) {
    this.dragging = true;
    event.target.focus();
    const from = toTissue(this.editor.viewer.place(event), this.axis),
      start = [...this.extents];
    drag(
      event,
      (now) => {
        const to = toTissue(this.editor.viewer.place(now), this.axis);
        this.extents = this.moved(start, which, [to[0] - from[0], to[1] - from[1]]);
        this.paint();
      },
      (completed) => {
        this.dragging = false;
        if (!completed) this.extents = start;
        if (this.extents.some((one, i) => one !== start[i])) this.editor.setExtents(this.extents);
        else this.paint();
      },
    );
  }

  key(event, which) {
    const by = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
    if (!by) return;
    event.preventDefault();
    event.stopPropagation();
    const size = event.shiftKey ? 10 : 1;
    this.extents = this.moved(
      this.extents,
      which,
      by.map((one) => one * size),
    );
    this.paint();
    this.editor.setExtents(this.extents);
  }
}
