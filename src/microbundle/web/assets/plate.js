// A plate as a heat map: a circle for each well, coloured by a metric; arrow keys go from well to well.

import { pageOf } from "./api.js";
import { RAMP, byId, colour, draw, make, written, withError } from "./shared.js";
import { STATES, VERDICTS } from "./page.js";

const SIDE = 40,
  EDGE = 26;

const letters = (row) =>
  (row >= 26 ? String.fromCharCode(64 + Math.floor(row / 26)) : "") + String.fromCharCode(65 + (row % 26));

// Colours never spread over less than a twentieth of the values: that would paint their errors.
function limits(values) {
  const low = Math.min(...values),
    high = Math.max(...values),
    least = 0.05 * Math.max(Math.abs(low), Math.abs(high));
  const more = Math.max(0, least - (high - low)) / 2;
  return [low - more, high + more];
}

export class Plates {
  constructor(host, run) {
    this.host = host;
    this.run = run;
    this.metric = make("select", { id: "plate-metric" });
    this.metric.addEventListener("change", () => this.paint());
    this.drawn = make("div");
    this.ramp = make("span", { class: "ramp" });
    this.ramp.style.background = `linear-gradient(to right, ${RAMP.map((c) => `rgb(${c.join(",")})`).join(",")})`;
    this.low = make("span");
    this.high = make("span");
    host.append(
      make("p", { class: "controls" }, make("label", {}, "Colour by ", this.metric)),
      this.drawn,
      make("div", { class: "bar" }, this.low, this.ramp, this.high),
      make(
        "p",
        { class: "note" },
        "A ring marks a verdict: solid for fail, dashed for review. A dashed well has no number. " +
          "Arrow keys go from well to well, Enter opens one.",
      ),
    );
  }

  // `plates` as the server gives them, `metrics` the columns there are.
  place(plates, metrics) {
    const before = this.metric.value;
    this.metrics = metrics;
    this.metric.replaceChildren(
      ...metrics.map((one) =>
        make(
          "option",
          { value: one.column, selected: one.column === before },
          `${one.label}${one.unit ? `, ${one.unit}` : ""}`,
        ),
      ),
      make("option", { value: "", selected: before === "" && !metrics.length }, "Verdict alone"),
    );
    this.wells = [];
    this.drawn.replaceChildren(...plates.map((plate) => this.plate(plate)));
    if (!plates.length) {
      this.drawn.append(
        make(
          "p",
          { class: "reason" },
          "The names of these movies tell no wells. Say how they are built under " +
            "Settings, “Names”: {well} stands for a part like A1 or B12.",
        ),
      );
    }
  }

  plate({ name, rows, cols, wells }) {
    const svg = draw("svg", {
      viewBox: `0 0 ${EDGE + cols * SIDE + 4} ${EDGE + rows * SIDE + 4}`,
      role: "group",
      "aria-label": `Plate ${name}; arrow keys go from well to well`,
    });
    for (let c = 0; c < cols; c += 1) svg.append(draw("text", { x: EDGE + (c + 0.5) * SIDE, y: EDGE / 2 }, c + 1));
    for (let r = 0; r < rows; r += 1) svg.append(draw("text", { x: EDGE / 2, y: EDGE + (r + 0.5) * SIDE }, letters(r)));
    svg.style.maxWidth = `${Math.min(62, 3 + 4.6 * cols)}rem`;
    const small = rows * cols > 96,
      own = new Map();
    const taken = new Set(wells.map((well) => `${well.row} ${well.col}`));
    for (let r = 0; r < rows; r += 1) {
      for (let c = 0; c < cols; c += 1) {
        if (!taken.has(`${r} ${c}`)) {
          svg.append(
            draw("circle", {
              class: "free",
              cx: EDGE + (c + 0.5) * SIDE,
              cy: EDGE + (r + 0.5) * SIDE,
              r: SIDE / 2 - 3,
            }),
          );
        }
      }
    }
    for (const well of wells) {
      const x = EDGE + (well.col + 0.5) * SIDE,
        y = EDGE + (well.row + 0.5) * SIDE;
      const ring = draw("circle", { cx: x, cy: y, r: SIDE / 2 - 3 }),
        text = draw("text", { class: "value", x, y });
      const link = draw(
        "a",
        { href: pageOf(this.run, well.key), tabindex: own.size ? -1 : 0 },
        ring,
        ...(small ? [] : [text]),
      );
      own.set(`${well.row} ${well.col}`, link);
      this.wells.push({ well, ring, text: small ? null : text, link });
      svg.append(link);
    }
    svg.addEventListener("keydown", (event) => {
      const by = { ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowDown: [1, 0], ArrowUp: [-1, 0] }[event.key];
      const at = wells.find((well) => own.get(`${well.row} ${well.col}`) === document.activeElement);
      if (!by || !at) return;
      event.preventDefault();
      for (let n = 1; n <= Math.max(rows, cols); n += 1) {
        const next = own.get(`${at.row + n * by[0]} ${at.col + n * by[1]}`);
        if (next) {
          own.get(`${at.row} ${at.col}`).setAttribute("tabindex", -1);
          next.setAttribute("tabindex", 0);
          next.focus();
          return;
        }
      }
    });
    return make("div", { class: "plate" }, ...(name ? [make("h3", {}, name)] : []), svg);
  }

  paint(movies = this.movies) {
    this.movies = movies;
    if (!this.wells || !movies) return;
    const shown = this.metrics.find((one) => one.column === this.metric.value);
    const value = (movie) => (shown ? (movie?.metrics?.[shown.column] ?? null) : null);
    const known = this.wells.map(({ well }) => value(movies.get(well.key))).filter((one) => one !== null);
    const [low, high] = limits(known);
    this.ramp.parentNode.hidden = !known.length;
    [this.low.textContent, this.high.textContent] = known.length
      ? [written(low, 3), `${written(high, 3)} ${shown.unit}`]
      : ["", ""];
    for (const { well, ring, text, link } of this.wells) {
      const movie = movies.get(well.key),
        one = value(movie);
      const paint = one === null ? null : colour(RAMP, high > low ? (one - low) / (high - low) : 0.5);
      ring.setAttribute(
        "class",
        `well${one === null ? " none" : ""}${
          movie?.verdict === "fail" || movie?.state === "failed" ? " bad" : movie?.verdict === "review" ? " look" : ""
        }`,
      );
      if (paint) ring.setAttribute("fill", `rgb(${paint.join(",")})`);
      else ring.removeAttribute("fill");
      if (text) {
        text.textContent = one === null ? "" : written(one, 3);
        const light = paint && 0.299 * paint[0] + 0.587 * paint[1] + 0.114 * paint[2] > 140;
        text.setAttribute("class", `value ${light ? "on-light" : "on-dark"}`);
      }
      const words = [
        well.well,
        ...Object.entries(well.columns ?? {})
          .filter(([key]) => !["well", "plate"].includes(key))
          .map(([key, told]) => `${key} ${told}`),
        one === null ? "no number" : `${withError(one, movie.se?.[shown.column])} ${shown.unit}`,
        VERDICTS[movie?.verdict] ?? STATES[movie?.state] ?? "",
      ]
        .filter(Boolean)
        .join(", ");
      link.setAttribute("aria-label", words);
      link.setAttribute("data-tip", words);
    }
    if (byId("tip")) byId("tip").hidden = true;
  }
}
