// Maps over the tissue's picture: displacement from the grid, strain from the sub-domains.

const DIVERGING = [[33, 60, 150], [58, 110, 190], [116, 165, 215], [180, 210, 235], [242, 242, 242], [245, 205, 180],
  [230, 150, 115], [200, 85, 65], [150, 20, 40]];
const OPACITY = 0.72;
const LEAST_PX = 0.01, LEAST_STRAIN = 1e-4; // Colours never spread over less: that would paint noise.
const ACROSS = 26;
const QUANTITIES = [
  { id: "size", name: "Displacement, size", of: "grid", value: (a, c) => Math.hypot(a, c) },
  { id: "along", name: "Displacement along the tissue", of: "grid", value: (a) => a, signed: true },
  { id: "across", name: "Displacement across the tissue", of: "grid", value: (a, c) => c, signed: true },
  { id: "cc", name: "Strain E_cc, along the tissue", of: "strain", signed: true },
  { id: "rr", name: "Strain E_rr, across the tissue", of: "strain", signed: true },
  { id: "rc", name: "Strain E_rc, shear", of: "strain", signed: true },
];

class Maps {
  constructor(data) {
    this.data = data;
    this.grid = data.map;
    this.strain = data.strain;
    [this.left, this.top, this.width, this.height] = data.view;
    const outline = document.querySelector(".over .mask");
    this.clip = new Path2D(outline?.getAttribute("d") ?? "");
    if (this.grid) {
      const bytes = Uint8Array.from(atob(this.grid.data), (c) => c.charCodeAt(0));
      this.coded = new Int16Array(bytes.buffer);
      this.cells = new OffscreenCanvas(this.grid.cols, this.grid.rows);
    }
    this.quantities = QUANTITIES.filter((q) => (q.of === "grid" ? this.grid : this.strain));
    for (const quantity of this.quantities) quantity.limit = this.limit(quantity);
  }

  // Displacement (along, across) of grid point p in a frame, in units of the code; null where it is not known.
  moved(frame, p) {
    const { rows, cols, every, count } = this.grid;
    const at = 2 * (Math.min(count - 1, Math.round(frame / every)) * rows * cols + p);
    return this.coded[at] === -32768 ? null : [this.coded[at], this.coded[at + 1]];
  }

  // The largest size over the whole movie, so that colours mean the same in every frame.
  limit(quantity) {
    let most = quantity.of === "strain" ? LEAST_STRAIN : 0;
    if (quantity.of === "grid") {
      for (let at = 0; at < this.coded.length; at += 2) {
        if (this.coded[at] !== -32768) most = Math.max(most, Math.abs(quantity.value(this.coded[at], this.coded[at + 1])));
      }
      return Math.max(most, LEAST_PX / this.grid.px_size) * this.grid.unit_size;
    }
    for (const frame of this.strain.E[quantity.id]) for (const value of frame) most = Math.max(most, Math.abs(value ?? 0));
    return most;
  }

  ramp(quantity) { return quantity.signed ? DIVERGING : RAMP; }

  // The colour bar's ends and stops.
  scale(quantity) {
    const unit = quantity.of === "grid" ? ` ${this.data.length_unit}` : "";
    return { low: quantity.signed ? `${written(-quantity.limit, 3)}${unit}` : "0", high: `${written(quantity.limit, 3)}${unit}`,
      stops: this.ramp(quantity).map((c) => `rgb(${c.join(",")})`).join(",") };
  }

  // Draws a quantity of one frame on a canvas that lies over the picture; null clears it.
  paint(canvas, quantity, frame) {
    const ratio = Math.max(1, Math.min(2, devicePixelRatio || 1)), size = (canvas.clientWidth || 640) * ratio;
    canvas.width = Math.round(size);
    canvas.height = Math.round(size * this.height / this.width);
    if (!quantity) return;
    const context = canvas.getContext("2d"), scale = canvas.width / this.width;
    context.setTransform(scale, 0, 0, scale, -this.left * scale, -this.top * scale);
    context.globalAlpha = OPACITY;
    if (quantity.of === "strain") this.paintStrain(context, quantity, frame);
    else this.paintGrid(context, quantity, frame);
  }

  share(quantity, value) {
    const limit = quantity.limit || 1;
    return quantity.signed ? 0.5 + 0.5 * value / limit : value / limit;
  }

  paintStrain(context, quantity, frame) {
    this.strain.corners.forEach((corners, s) => {
      const value = this.strain.E[quantity.id][frame][s];
      if (value === null) return;
      context.fillStyle = `rgb(${colour(DIVERGING, this.share(quantity, value)).join(",")})`;
      context.beginPath();
      for (const [row, col] of corners) context.lineTo(col, row);
      context.fill();
    });
  }

  paintGrid(context, quantity, frame) {
    const { rows, cols, origin, row_step: down, col_step: right, unit_size: unit } = this.grid;
    let values = Array.from({ length: rows * cols }, (_, p) => {
      const moved = this.moved(frame, p);
      return moved && quantity.value(...moved) * unit;
    });
    for (let ring = 0; ring < 2; ring += 1) values = this.spread(values);
    const pixels = new ImageData(cols, rows), ramp = this.ramp(quantity);
    values.forEach((value, p) => {
      if (value !== null) pixels.data.set([...colour(ramp, this.share(quantity, value)), 255], 4 * p);
    });
    this.cells.getContext("2d").putImageData(pixels, 0, 0);
    context.clip(this.clip, "evenodd");
    context.transform(right[1], right[0], down[1], down[0], origin[1] - 0.5 * (right[1] + down[1]),
      origin[0] - 0.5 * (right[0] + down[0]));
    context.imageSmoothingQuality = "high";
    context.drawImage(this.cells, 0, 0);
  }

  // Gives points without a value the mean of their neighbours, so that colours reach the tissue's border.
  spread(values) {
    const { rows, cols } = this.grid;
    return values.map((value, p) => {
      if (value !== null) return value;
      const row = Math.floor(p / cols), col = p % cols;
      let sum = 0, count = 0;
      for (let r = Math.max(0, row - 1); r <= Math.min(rows - 1, row + 1); r += 1) {
        for (let c = Math.max(0, col - 1); c <= Math.min(cols - 1, col + 1); c += 1) {
          if (values[r * cols + c] !== null) {
            sum += values[r * cols + c];
            count += 1;
          }
        }
      }
      return count ? sum / count : null;
    });
  }

  // Arrows of the displacement as one path, and how many times too long they are drawn.
  arrows(frame) {
    if (!this.grid) return { path: "", times: 1 };
    const { rows, cols, origin, row_step: down, col_step: right, along, px_size: px } = this.grid;
    const every = Math.max(1, Math.round(cols / ACROSS)), spacing = every * Math.hypot(...right);
    const most = this.quantities[0].limit / this.grid.unit_size * px;
    const times = most > 0 ? Math.max(1, nice(2 * spacing / most) / 2) : 1;
    let path = "";
    for (let i = Math.floor(every / 2); i < rows; i += every) {
      for (let j = Math.floor(every / 2); j < cols; j += every) {
        const moved = this.moved(frame, i * cols + j);
        if (!moved) continue;
        const [a, c] = moved.map((one) => one * px * times);
        const y = origin[0] + i * down[0] + j * right[0], x = origin[1] + i * down[1] + j * right[1];
        const dy = a * along[0] + c * along[1], dx = a * along[1] - c * along[0];
        path += `M${x.toFixed(1)} ${y.toFixed(1)}l${dx.toFixed(1)} ${dy.toFixed(1)}`;
        if (Math.hypot(dx, dy) > 1) {
          for (const side of [-1, 1]) {
            const hx = -0.3 * dx + side * 0.2 * dy, hy = -0.3 * dy - side * 0.2 * dx;
            path += `M${(x + dx).toFixed(1)} ${(y + dy).toFixed(1)}l${hx.toFixed(1)} ${hy.toFixed(1)}`;
          }
        }
      }
    }
    return { path, times };
  }
}
