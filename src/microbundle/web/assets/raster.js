// A mask as pixels: painted on, filled from outlines, kept as lengths of runs, sent as a PNG.

// The picture in a data address.
export const unpacked = (address) =>
  new Blob([Uint8Array.from(atob(address.split(",")[1]), (one) => one.charCodeAt(0))], { type: "image/png" });

export class Raster {
  constructor(rows, cols, data = new Uint8Array(rows * cols)) {
    Object.assign(this, { rows, cols, data });
  }

  static async fromPng(blob, rows, cols) {
    const bitmap = await createImageBitmap(blob);
    const context = new OffscreenCanvas(cols, rows).getContext("2d", { willReadFrequently: true });
    context.drawImage(bitmap, 0, 0, cols, rows);
    bitmap.close();
    const { data } = context.getImageData(0, 0, cols, rows);
    return new Raster(
      rows,
      cols,
      Uint8Array.from({ length: rows * cols }, (_, p) => (data[4 * p] > 127 && data[4 * p + 3] > 127 ? 1 : 0)),
    );
  }

  // What lies within outlines (rings of [row, col]); a ring within a ring is a hole.
  static fromRings(rings, rows, cols) {
    const context = new OffscreenCanvas(cols, rows).getContext("2d", { willReadFrequently: true });
    for (const ring of rings) {
      ring.forEach(([row, col], i) => context[i ? "lineTo" : "moveTo"](col + 0.5, row + 0.5));
      context.closePath();
    }
    context.fill("evenodd");
    const { data } = context.getImageData(0, 0, cols, rows);
    return new Raster(
      rows,
      cols,
      Uint8Array.from({ length: rows * cols }, (_, p) => (data[4 * p + 3] > 127 ? 1 : 0)),
    );
  }

  // Lengths of runs of 0 and 1 in turn, starting with 0.
  static fromRuns(runs, rows, cols) {
    const raster = new Raster(rows, cols);
    let at = 0;
    runs.forEach((length, i) => {
      if (i % 2) raster.data.fill(1, at, at + length);
      at += length;
    });
    return raster;
  }

  get runs() {
    const out = [];
    let from = 0;
    for (let p = 1; p <= this.data.length; p += 1) {
      if (p === this.data.length || this.data[p] !== this.data[p - 1]) {
        if (!out.length && this.data[from]) out.push(0);
        out.push(p - from);
        from = p;
      }
    }
    return out;
  }

  get empty() {
    return !this.data.includes(1);
  }

  copy() {
    return new Raster(this.rows, this.cols, this.data.slice());
  }

  // Sets a round spot, or every pixel within `radius` of the line from one point to another.
  stroke([r0, c0], [r1, c1], radius, value) {
    const reach = Math.ceil(radius),
      dr = r1 - r0,
      dc = c1 - c0,
      length2 = dr * dr + dc * dc;
    for (
      let r = Math.max(0, Math.floor(Math.min(r0, r1)) - reach);
      r <= Math.min(this.rows - 1, Math.ceil(Math.max(r0, r1)) + reach);
      r += 1
    ) {
      for (
        let c = Math.max(0, Math.floor(Math.min(c0, c1)) - reach);
        c <= Math.min(this.cols - 1, Math.ceil(Math.max(c0, c1)) + reach);
        c += 1
      ) {
        const share = length2 ? Math.max(0, Math.min(1, ((r - r0) * dr + (c - c0) * dc) / length2)) : 0;
        if ((r - r0 - share * dr) ** 2 + (c - c0 - share * dc) ** 2 <= radius * radius)
          this.data[r * this.cols + c] = value;
      }
    }
  }

  paint(canvas, [red, green, blue]) {
    const pixels = new ImageData(this.cols, this.rows);
    const all = new Uint32Array(pixels.data.buffer),
      one = new Uint32Array(new Uint8Array([red, green, blue, 90]).buffer)[0];
    for (let p = 0; p < all.length; p += 1) if (this.data[p]) all[p] = one;
    [canvas.width, canvas.height] = [this.cols, this.rows];
    canvas.getContext("2d").putImageData(pixels, 0, 0);
  }

  toPng() {
    const canvas = document.createElement("canvas"),
      pixels = new ImageData(this.cols, this.rows);
    const all = new Uint32Array(pixels.data.buffer);
    for (let p = 0; p < all.length; p += 1) all[p] = this.data[p] ? 0xffffffff : 0xff000000;
    [canvas.width, canvas.height] = [this.cols, this.rows];
    canvas.getContext("2d").putImageData(pixels, 0, 0);
    return canvas.toDataURL("image/png");
  }
}
