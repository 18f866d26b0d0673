// A chart of lines that zooms, pans, and tells the values under the pointer or at the cursor.
// A line is {name, x, y, se, colour (1 to 6, 0 for faint), cut}; missing values are null and leave a gap.

const MANY = 8; // More curves are told one at a time.
const EDGE = { left: 62, right: 10, top: 16, bottom: 30 };

class Chart {
  // `range` is a State of {low, high} that charts may share; `cursor` gives the x of the cursor, or null;
  // `pick` is called with the x that was clicked. With `free`, lines are curves in the plane rather than functions of x.
  constructor(host, options) {
    Object.assign(this, { height: 150, beats: [], cursor: () => null, pick: null, step: null, free: false }, options);
    this.now = make("span", { class: "now" });
    this.svg = draw("svg", { tabindex: "0", role: "group", "aria-roledescription": "chart" });
    this.legend = make("div", { class: "legend" });
    this.heading = make("strong");
    this.root = make("div", { class: "chart" }, make("div", { class: "head" }, this.heading, this.now), this.svg, this.legend);
    host.append(this.root);
    this.width = 600;
    this.range.listen(() => this.render());
    new ResizeObserver(() => {
      const width = Math.round(this.svg.clientWidth);
      if (width > 80 && width !== this.width) {
        this.width = width;
        this.render();
      }
    }).observe(this.root);
    this.listenToPointer();
    this.listenToKeys();
    this.show(this.lines, this.title);
  }

  show(lines, title) {
    this.lines = lines;
    this.title = title;
    this.heading.textContent = `${title}${this.unit ? `, ${this.unit}` : ""}`;
    const values = lines.flatMap((line) => line.y.flatMap((y, i) => (y === null ? []
      : [y - (line.se?.[i] ?? 0), y + (line.se?.[i] ?? 0)])));
    const xs = lines.flatMap((line) => line.x.filter((x) => x !== null));
    this.known = values.length > 0;
    const fold = (list, f, start) => list.reduce((a, b) => f(a, b), start);
    const low = fold(values, Math.min, Infinity), high = fold(values, Math.max, -Infinity);
    const free = (high - low || Math.abs(high) || 1) * 0.06;
    [this.bottom, this.top] = this.known ? [low - free, high + free] : [0, 1];
    [this.first, this.last] = xs.length ? [fold(xs, Math.min, Infinity), fold(xs, Math.max, -Infinity)] : [0, 1];
    if (this.last === this.first) this.last = this.first + 1;
    const named = lines.filter((line) => line.colour);
    this.many = named.length > MANY;
    this.legend.replaceChildren(...(named.length < 2 ? [] : this.many ? [`${named.length} curves; point at one for its name`]
      : named.map((line) => make("span", {},
      draw("svg", { viewBox: "0 0 26 12", "aria-hidden": "true" }, draw("path", { d: "M0 6H26",
        class: `c${line.colour}${line.cut ? " cut" : ""}`, "stroke-dasharray": line.cut ? "5 4" : null })), line.name))));
    this.render();
  }

  get low() { return this.range.values.low ?? this.first; }

  get high() { return this.range.values.high ?? this.last; }

  x(value) { return EDGE.left + (value - this.low) / (this.high - this.low) * (this.width - EDGE.left - EDGE.right); }

  y(value) { return EDGE.top + (this.top - value) / (this.top - this.bottom) * (this.height - EDGE.top - EDGE.bottom); }

  value(pixel) {
    return this.low + (pixel - EDGE.left) / (this.width - EDGE.left - EDGE.right) * (this.high - this.low);
  }

  render() {
    const { width, height } = this, right = width - EDGE.right, ground = height - EDGE.bottom;
    const parts = [], clip = `clip-${this.id}`;
    parts.push(draw("clipPath", { id: clip }, draw("rect", { x: EDGE.left, y: EDGE.top, width: right - EDGE.left,
      height: ground - EDGE.top })));
    const inside = draw("g", { "clip-path": `url(#${clip})` });
    for (const [number, beat] of this.beats.entries()) {
      inside.append(draw("rect", { class: `beat${beat.complete ? "" : " cut"}`, x: this.x(beat.from) + 1, y: EDGE.top,
        width: Math.max(0, this.x(beat.to) - this.x(beat.from) - 2), height: ground - EDGE.top }));
      inside.append(draw("line", { class: "peak", x1: this.x(beat.peak), x2: this.x(beat.peak), y1: EDGE.top, y2: ground }));
      const at = this.x(beat.peak);
      if (at >= EDGE.left - 0.5 && at <= right + 0.5) {
        parts.push(draw("text", { x: at, y: EDGE.top - 5, "text-anchor": "middle" }, `${number + 1}`));
      }
    }
    for (const [value, text] of ticks(this.bottom, this.top, Math.max(2, height / 45))) {
      parts.push(draw("text", { x: EDGE.left - 6, y: this.y(value) + 4, "text-anchor": "end" }, text));
      inside.append(draw("line", { class: value === 0 ? "zero" : "grid", x1: EDGE.left, x2: right, y1: this.y(value),
        y2: this.y(value) }));
    }
    for (const [value, text] of ticks(this.low, this.high, width / 90)) {
      parts.push(draw("text", { x: this.x(value), y: ground + 14, "text-anchor": "middle" }, text));
    }
    parts.push(draw("text", { x: right, y: height - 3, "text-anchor": "end" }, this.xLabel));
    if (!this.known) parts.push(draw("text", { x: width / 2, y: height / 2, "text-anchor": "middle" }, "nothing is known here"));
    for (const line of this.lines) this.drawLine(inside, line);
    this.mark = draw("line", { class: "cursor", y1: EDGE.top, y2: ground });
    this.under = draw(this.free ? "circle" : "line", { class: "hover", y1: EDGE.top, y2: ground, r: 4, fill: "none",
      visibility: "hidden" });
    this.brush = draw("rect", { class: "brush", y: EDGE.top, height: ground - EDGE.top, visibility: "hidden" });
    inside.append(this.mark, this.under, this.brush);
    parts.push(inside, draw("rect", { class: "frame-of", x: EDGE.left, y: EDGE.top, width: right - EDGE.left,
      height: ground - EDGE.top }));
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.svg.setAttribute("aria-label", `${this.title}${this.unit ? `, ${this.unit}` : ""}, over ${this.xLabel}`);
    this.svg.replaceChildren(...parts);
    this.moveCursor();
  }

  drawLine(into, line) {
    let curve = "", open = false;
    line.y.forEach((y, i) => {
      if (y === null || line.x[i] === null) {
        open = false;
        return;
      }
      curve += `${open ? "L" : "M"}${this.x(line.x[i]).toFixed(1)} ${this.y(y).toFixed(1)}`;
      open = true;
    });
    if (line.se && !this.free) {
      let run = [];
      const band = () => {
        if (run.length > 1) {
          const above = run.map((i) => `${this.x(line.x[i]).toFixed(1)} ${this.y(line.y[i] + line.se[i]).toFixed(1)}`);
          const below = run.map((i) => `${this.x(line.x[i]).toFixed(1)} ${this.y(line.y[i] - line.se[i]).toFixed(1)}`);
          into.append(draw("path", { class: `band c${line.colour}`, d: `M${above.join("L")}L${below.reverse().join("L")}Z` }));
        }
        run = [];
      };
      line.y.forEach((y, i) => (y !== null && line.se[i] !== null ? run.push(i) : band()));
      band();
    }
    const look = line.colour ? `c${line.colour}` : "faint";
    into.append(draw("path", { class: `curve ${look}${line.cut ? " cut" : ""}`, d: curve }));
  }

  moveCursor() {
    const at = this.cursor();
    this.mark.setAttribute("visibility", at === null || this.free ? "hidden" : "visible");
    if (at === null) return;
    this.mark.setAttribute("x1", this.x(at));
    this.mark.setAttribute("x2", this.x(at));
    this.now.textContent = this.told(at);
  }

  // The values of the named lines nearest to x, with units and standard errors.
  told(x) {
    const named = this.lines.filter((line) => line.colour && line.x.length);
    const shown = named.map((line) => {
      const i = nearest(line.x, x);
      return { line, i, away: Math.abs(line.x[i] - x) };
    }).filter((one) => one.away <= (this.step ?? Infinity) * 0.51);
    const values = shown.map(({ line, i }) => `${named.length > 1 ? `${line.name}: ` : ""}${
      withError(line.y[i], line.se?.[i])}${this.unit ? ` ${this.unit}` : ""}`);
    return [`${this.where(x)}`, ...values].join("  ·  ");
  }

  where(x) { return `${written(x)} ${this.xUnit}`; }

  listenToPointer() {
    let start = null;
    const place = (event) => {
      const box = this.svg.getBoundingClientRect(), scale = this.width / box.width;
      return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    };
    this.svg.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      start = { at: place(event)[0], low: this.low, high: this.high, pan: event.shiftKey };
      this.svg.setPointerCapture(event.pointerId);
    });
    this.svg.addEventListener("pointermove", (event) => {
      const [px, py] = place(event);
      this.hover(px, py, event);
      if (!start || Math.abs(px - start.at) < 4) return;
      if (start.pan) {
        const moved = (start.at - px) / (this.width - EDGE.left - EDGE.right) * (start.high - start.low);
        this.setRange(start.low + moved, start.high + moved);
      } else if (!this.free) {
        this.brush.setAttribute("visibility", "visible");
        this.brush.setAttribute("x", Math.min(px, start.at));
        this.brush.setAttribute("width", Math.abs(px - start.at));
      }
    });
    this.svg.addEventListener("pointerup", (event) => {
      const [px] = place(event);
      if (start && Math.abs(px - start.at) < 4) this.pick?.(this.value(px));
      else if (start && !start.pan && !this.free) {
        this.setRange(this.value(Math.min(px, start.at)), this.value(Math.max(px, start.at)));
      }
      start = null;
      this.brush.setAttribute("visibility", "hidden");
    });
    this.svg.addEventListener("pointercancel", () => { start = null; });
    this.svg.addEventListener("pointerleave", () => {
      this.under.setAttribute("visibility", "hidden");
      byId("tip").hidden = true;
      this.moveCursor();
    });
    this.svg.addEventListener("dblclick", () => this.setRange(null, null));
  }

  hover(px, py, event) {
    let text;
    if (this.free || this.many) {
      const near = this.closest(px, py);
      if (!near) return;
      const at = this.x(near.line.x[near.i]);
      for (const [key, value] of Object.entries({ cx: at, x1: at, x2: at, cy: this.y(near.line.y[near.i]) })) {
        this.under.setAttribute(key, value);
      }
      text = `${near.line.name}: ${withError(near.line.y[near.i], near.line.se?.[near.i])} ${this.unit} at ${
        written(near.line.x[near.i])} ${this.xUnit}`;
    } else {
      if (px < EDGE.left || px > this.width - EDGE.right) return;
      const line = this.lines.find((one) => one.colour && one.x.length);
      if (!line) return;
      const at = line.x[nearest(line.x, this.value(px))];
      this.under.setAttribute("x1", this.x(at));
      this.under.setAttribute("x2", this.x(at));
      text = this.told(at);
    }
    this.under.setAttribute("visibility", "visible");
    this.now.textContent = text;
    const tip = byId("tip");
    tip.textContent = text;
    tip.hidden = false;
    tip.style.left = `${Math.max(8, Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8))}px`;
    tip.style.top = `${Math.min(event.clientY + 16, innerHeight - tip.offsetHeight - 8)}px`;
  }

  closest(px, py) {
    let best = null;
    for (const line of this.lines) {
      line.x.forEach((x, i) => {
        if (!line.colour || x === null || line.y[i] === null) return;
        const away = (this.x(x) - px) ** 2 + (this.y(line.y[i]) - py) ** 2;
        if (!best || away < best.away) best = { line, i, away };
      });
    }
    return best && best.away < 900 ? best : null;
  }

  // Shows x from low to high, within what there is; nulls show everything.
  setRange(low, high) {
    const all = this.last - this.first;
    if (low === null || high - low >= all) return this.range.set({ low: null, high: null });
    const size = Math.max(high - low, this.step ? 4 * this.step : all / 200);
    const from = Math.max(this.first, Math.min(low, this.last - size));
    return this.range.set({ low: from, high: from + size });
  }

  zoom(factor) {
    const middle = 0.5 * (this.low + this.high), half = 0.5 * factor * (this.high - this.low);
    this.setRange(middle - half, middle + half);
  }

  pan(share) {
    const by = share * (this.high - this.low);
    this.setRange(this.low + by, this.high + by);
  }

  listenToKeys() {
    this.svg.addEventListener("keydown", (event) => {
      const side = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (side && event.shiftKey) this.pan(0.2 * side);
      else if (side && this.pick && this.cursor() !== null) this.pick(this.cursor() + side * this.step);
      else if (event.key === "+" || event.key === "=") this.zoom(0.5);
      else if (event.key === "-") this.zoom(2);
      else if (event.key === "0" || event.key === "Escape") this.setRange(null, null);
      else return;
      event.preventDefault();
    });
  }
}

function nearest(list, value) {
  let best = 0;
  list.forEach((x, i) => { if (x !== null && Math.abs(x - value) < Math.abs(list[best] - value)) best = i; });
  return best;
}
