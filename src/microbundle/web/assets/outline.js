// The corners of a mask's outline: dragged by mouse, moved by keys, added on an edge, taken away.

import { drag } from "./drag.js";
import { Raster } from "./raster.js";
import { draw } from "./shared.js";
import { say } from "./page.js";

const MOST_CORNERS = 48,
  LEAST_AREA = 12;

export const ringPath = (rings) =>
  rings
    .map((ring) =>
      ring.length
        ? `M${ring.map(([row, col]) => `${(col + 0.5).toFixed(1)} ${(row + 0.5).toFixed(1)}`).join("L")}Z`
        : "",
    )
    .join("");

const area = (ring) =>
  Math.abs(
    ring.reduce((sum, [r, c], i) => {
      const [r1, c1] = ring[(i + 1) % ring.length];
      return sum + r * c1 - r1 * c;
    }, 0),
  ) / 2;

// A ring with as few corners as keep it within a distance (Douglas and Peucker).
export function simplified(ring, most = MOST_CORNERS) {
  let kept = ring;
  for (let away = 0.7; kept.length > most || away < 1.1; away *= 1.4) {
    const half = ring.reduce((best, p, i) => (distance(p, ring[0]) > distance(ring[best], ring[0]) ? i : best), 0);
    kept = [
      ...thinned(ring.slice(0, half + 1), away).slice(0, -1),
      ...thinned([...ring.slice(half), ring[0]], away).slice(0, -1),
    ];
  }
  return kept;
}

const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

function thinned(line, away) {
  const keep = new Uint8Array(line.length),
    open = [[0, line.length - 1]];
  keep[0] = keep[line.length - 1] = 1;
  while (open.length) {
    const [a, z] = open.pop(),
      [p, q] = [line[a], line[z]],
      length = distance(p, q);
    let far = 0,
      at = -1;
    for (let i = a + 1; i < z; i += 1) {
      const off = length
        ? Math.abs((q[0] - p[0]) * (p[1] - line[i][1]) - (p[0] - line[i][0]) * (q[1] - p[1])) / length
        : distance(line[i], p);
      if (off > far) [far, at] = [off, i];
    }
    if (far > away) {
      keep[at] = 1;
      open.push([a, at], [at, z]);
    }
  }
  return line.filter((_, i) => keep[i]);
}

export class OutlineTool {
  constructor(editor) {
    this.editor = editor;
    this.layer = draw("g", { class: "corners" });
    this.current = [0, 0];
  }

  start() {
    this.editor.viewer.over.append(this.layer);
    this.made = undefined;
    this.render();
    say("Corners. Tab to a corner; arrow keys move it, N and P go on, Insert adds one, Delete takes it away.");
  }

  stop() {
    this.layer.remove();
  }

  // Follows the mask, but keeps its own corners of a mask that it made itself.
  render() {
    const mask = this.editor.mask(),
      fresh = this.made !== mask;
    if (this.dragging) return;
    if (fresh) {
      this.rings = this.editor
        .polygons()
        .filter((ring) => area(ring) >= LEAST_AREA)
        .map((ring) => simplified(ring));
      this.made = mask;
    }
    this.paint();
  }

  paint() {
    const focused = this.layer.contains(document.activeElement),
      size = 6 / this.editor.viewer.scale;
    const [ring, corner] = this.current;
    if (!this.rings[ring]?.[corner]) this.current = [0, 0];
    const edge = draw("path", {
      class: "edge",
      d: ringPath(this.rings),
      "stroke-width": 12 / this.editor.viewer.scale,
    });
    edge.addEventListener("pointerdown", (event) => this.addAt(event));
    this.layer.replaceChildren(draw("path", { class: "own", d: ringPath(this.rings) }), edge);
    this.dots = this.rings.map((points, r) => points.map((point, i) => this.dot(r, i, point, size)));
    if (focused) this.dots[this.current[0]]?.[this.current[1]]?.focus();
  }

  dot(r, i, [row, col], size) {
    const chosen = r === this.current[0] && i === this.current[1];
    const dot = draw("circle", {
      class: "corner",
      cx: col + 0.5,
      cy: row + 0.5,
      r: size,
      tabindex: chosen ? 0 : -1,
      role: "button",
      "aria-label": `corner ${i + 1} of ${this.rings[r].length}, row ${Math.round(row)}, column ${Math.round(col)}`,
    });
    dot.addEventListener("pointerdown", (event) => this.drag(event, r, i));
    dot.addEventListener("keydown", (event) => this.key(event, r, i));
    dot.addEventListener("focus", () => {
      this.current = [r, i];
    });
    this.layer.append(dot);
    return dot;
  }

  drag(event, r, i) {
    if (event.button !== 0) return;
    this.current = [r, i];
    this.dragging = true;
    const dot = this.dots[r][i],
      [own, edge] = this.layer.children,
      start = this.rings[r][i];
    dot.focus();
    drag(
      event,
      (moved) => {
        this.rings[r][i] = this.editor.viewer.inside(this.editor.viewer.place(moved));
        const [row, col] = this.rings[r][i];
        dot.setAttribute("cx", col + 0.5);
        dot.setAttribute("cy", row + 0.5);
        for (const path of [own, edge]) path.setAttribute("d", ringPath(this.rings));
      },
      (completed) => {
        this.dragging = false;
        if (!completed) this.rings[r][i] = start;
        if (distance(this.rings[r][i], start) > 0.05) this.commit();
        else this.render();
      },
    );
  }

  addAt(event) {
    if (event.button !== 0) return;
    event.preventDefault();
    event.stopPropagation();
    const at = this.editor.viewer.place(event);
    let best = null;
    this.rings.forEach((ring, r) =>
      ring.forEach((a, i) => {
        const b = ring[(i + 1) % ring.length],
          dr = b[0] - a[0],
          dc = b[1] - a[1],
          length2 = dr * dr + dc * dc || 1;
        const share = Math.max(0, Math.min(1, ((at[0] - a[0]) * dr + (at[1] - a[1]) * dc) / length2));
        const off = distance(at, [a[0] + share * dr, a[1] + share * dc]);
        if (!best || off < best.off) best = { off, r, i };
      }),
    );
    if (!best) return;
    this.rings[best.r].splice(best.i + 1, 0, at);
    this.current = [best.r, best.i + 1];
    this.paint();
    this.drag(event, ...this.current);
  }

  key(event, r, i) {
    const ring = this.rings[r],
      by = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
    if (event.ctrlKey || event.metaKey) return;
    const goTo = (to) => {
      const flat = this.rings.flatMap((points, n) => points.map((_, k) => [n, k]));
      const here = flat.findIndex(([n, k]) => n === r && k === i);
      this.current = flat[(here + to + flat.length) % flat.length];
      this.paint();
    };
    if (by) {
      const size = event.shiftKey ? 10 : 1;
      ring[i] = this.editor.viewer.inside([ring[i][0] + size * by[0], ring[i][1] + size * by[1]]);
      this.commit();
    } else if (event.key === "n" || event.key === "N") goTo(1);
    else if (event.key === "p" || event.key === "P") goTo(-1);
    else if (event.key === "Insert" || event.key === "i") {
      const next = ring[(i + 1) % ring.length];
      ring.splice(i + 1, 0, [(ring[i][0] + next[0]) / 2, (ring[i][1] + next[1]) / 2]);
      this.current = [r, i + 1];
      this.paint();
    } else if ((event.key === "Delete" || event.key === "Backspace") && ring.length > 3) {
      ring.splice(i, 1);
      this.current = [r, Math.min(i, ring.length - 1)];
      this.commit();
    } else return;
    event.preventDefault();
    event.stopPropagation();
  }

  commit() {
    const { rows, cols } = this.editor.viewer.info;
    this.dragging = true;
    this.made = this.editor.setMask(Raster.fromRings(this.rings, rows, cols));
    this.dragging = false;
    this.paint();
  }
}
