// Undo and redo over whole states that are never changed in place.

const MOST = 100;

export class History {
  constructor(first, changed) {
    this.states = [first];
    this.at = 0;
    this.changed = changed;
  }

  get now() {
    return this.states[this.at];
  }

  get canUndo() {
    return this.at > 0;
  }

  get canRedo() {
    return this.at < this.states.length - 1;
  }

  push(state) {
    this.states = [...this.states.slice(Math.max(0, this.at + 2 - MOST), this.at + 1), state];
    this.at = this.states.length - 1;
    this.changed();
  }

  undo() {
    this.move(-1);
  }

  redo() {
    this.move(1);
  }

  move(by) {
    const to = this.at + by;
    if (to < 0 || to >= this.states.length) return;
    this.at = to;
    this.changed();
  }
}
