// A table that sorts by any column, finds rows by their words, and renews only the rows that changed.

import { make } from "./shared.js";

const MOST = 500;
const names = new Intl.Collator(undefined, { numeric: true, sensitivity: "base" });

export class Table {
  // A column is {id, label, unit, tip, value(row), cell(row), words}; `value` sorts, `cell` gives what stands there.
  constructor(host, { label, key, columns, first }) {
    Object.assign(this, {
      key,
      columns,
      sorted: { id: first ?? columns[0].id, down: false },
      found: "",
      all: [],
      most: MOST,
    });
    this.note = make("p", { class: "note" });
    this.rows = new Map();
    this.head = make("tr");
    this.body = make("tbody");
    this.more = make("button", { type: "button", hidden: true });
    this.more.addEventListener("click", () => {
      this.most += MOST;
      this.render();
    });
    host.append(
      make(
        "div",
        { class: "scroll all", role: "region", "aria-label": label, tabindex: "0" },
        make(
          "table",
          {},
          make("caption", {}, "Press a column’s name to sort by it."),
          make("thead", {}, this.head),
          this.body,
        ),
      ),
      this.more,
      this.note,
    );
    this.setColumns(columns);
  }

  setColumns(columns) {
    const shape = JSON.stringify(columns.map(({ id, label, unit }) => [id, label, unit]));
    this.columns = columns;
    if (shape === this.shape) return;
    this.shape = shape;
    this.rows.clear();
    this.head.replaceChildren(
      ...columns.map((column) => {
        const head = make("th", { scope: "col", class: column.words ? "words" : (column.look ?? null) });
        if (column.value) {
          const pressed = make(
            "button",
            { type: "button", "data-tip": column.tip ?? null },
            column.label,
            ...(column.unit ? [" ", make("span", { class: "unit" }, column.unit)] : []),
            make("span", { class: "way", "aria-hidden": "true" }),
          );
          pressed.addEventListener("click", () => this.sortBy(column.id));
          head.append(pressed);
        } else head.append(make("span", { class: "unseen" }, column.label));
        head.dataset.column = column.id;
        return head;
      }),
    );
    this.markSorted();
  }

  sortBy(id) {
    this.sorted = { id, down: this.sorted.id === id && !this.sorted.down };
    this.markSorted();
    this.render();
  }

  markSorted() {
    for (const head of this.head.cells) {
      if (head.dataset.column === this.sorted.id)
        head.setAttribute("aria-sort", this.sorted.down ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    }
  }

  find(text) {
    this.found = text.trim().toLowerCase();
    this.render();
  }

  show(all) {
    this.all = all;
    this.render();
  }

  ordered() {
    const column = this.columns.find((one) => one.id === this.sorted.id) ?? this.columns.find((one) => one.value);
    const sign = this.sorted.down ? -1 : 1,
      missing = (value) => value === null || value === undefined || value === "";
    const words = (row) =>
      this.columns
        .map((one) => one.value?.(row) ?? "")
        .join(" ")
        .toLowerCase();
    const kept = this.found ? this.all.filter((row) => words(row).includes(this.found)) : [...this.all];
    return kept
      .map((row) => [column.value(row), row])
      .sort(([a], [b]) => {
        if (missing(a) || missing(b)) return Number(missing(a)) - Number(missing(b));
        return sign * (typeof a === "number" && typeof b === "number" ? a - b : names.compare(a, b));
      })
      .map(([, row]) => row);
  }

  render() {
    const ordered = this.ordered(),
      shown = ordered.slice(0, this.most),
      drawn = [];
    for (const row of shown) {
      const key = this.key(row),
        signature = JSON.stringify(row);
      let kept = this.rows.get(key);
      if (!kept || kept.signature !== signature) {
        const cells = this.columns.map((column) => {
          const content = column.cell ? column.cell(row) : (column.value(row) ?? "–");
          const kind = column.rowHead
            ? make("th", { scope: "row" })
            : make("td", { class: column.words ? "words" : (column.look ?? null) });
          kind.append(...[content].flat());
          return kind;
        });
        if (kept) kept.line.replaceChildren(...cells);
        else kept = { line: make("tr", {}, ...cells) };
        kept.signature = signature;
        this.rows.set(key, kept);
      }
      drawn.push(kept.line);
    }
    const focused = this.body.contains(document.activeElement) ? document.activeElement : null;
    const same = drawn.length === this.body.rows.length && drawn.every((line, i) => this.body.rows[i] === line);
    if (!same) this.body.replaceChildren(...drawn);
    if (focused?.isConnected && document.activeElement !== focused) focused.focus();
    this.more.hidden = ordered.length <= this.most;
    this.more.textContent = `Show ${Math.min(MOST, ordered.length - this.most)} more of ${ordered.length}`;
  }
}
