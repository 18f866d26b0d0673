// Frames of a movie, fetched when they are needed and kept within a bound of memory.

import { picture } from "./api.js";

const MOST_BYTES = 96e6,
  LEAST = 12,
  AT_ONCE = 4;

export class Frames {
  // `address(t)` is where a frame is; `arrived(t)` hears of each that came, `failed(error)` of the first that did not.
  constructor(address, arrived, failed) {
    Object.assign(this, {
      address,
      arrived,
      failed,
      kept: new Map(),
      loading: new Set(),
      wanted: null,
      line: [],
      turn: 0,
    });
  }

  at(t) {
    const found = this.kept.get(t);
    if (found) {
      this.kept.delete(t);
      this.kept.set(t, found);
    }
    return found ?? null;
  }

  // Asks for a frame first, and then for those of a list, in its order.
  want(t, line = []) {
    this.wanted = t;
    this.line = line;
    this.pump();
  }

  // Another contrast or size: what is kept is no longer right.
  forget() {
    this.turn += 1;
    for (const one of this.kept.values()) one.close();
    this.kept.clear();
    this.loading.clear();
    this.told = false;
  }

  pump() {
    for (const t of [this.wanted, ...this.line]) {
      if (this.loading.size >= AT_ONCE) return;
      if (t !== null && !this.kept.has(t) && !this.loading.has(t)) this.load(t);
    }
  }

  async load(t) {
    const { turn } = this;
    this.loading.add(t);
    try {
      const bitmap = await createImageBitmap(await picture(this.address(t)));
      if (turn !== this.turn) {
        bitmap.close();
        return;
      }
      this.kept.set(t, bitmap);
      const most = Math.max(LEAST, Math.floor(MOST_BYTES / (4 * bitmap.width * bitmap.height)));
      for (const [old, one] of this.kept) {
        if (this.kept.size <= most) break;
        if (old === this.wanted || old === t) continue;
        one.close();
        this.kept.delete(old);
      }
      this.loading.delete(t);
      this.arrived(t);
      this.pump();
    } catch (error) {
      if (turn !== this.turn) return;
      this.loading.delete(t);
      this.line = [];
      if (!this.told) this.failed(error);
      this.told = true;
    }
  }
}
