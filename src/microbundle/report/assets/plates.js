// Maps of plates: a metric or the groups, in the geometry of the plate. Wells are links to their reports; arrow keys
// move from well to well.

const GROUP_COLOURS = ["#56B4E9", "#E69F00", "#009E73", "#F0E442", "#CC79A7", "#0072B2", "#D55E00", "#8c8c8c"];
const GROUPS = "groups";
const EDGE = 26;

function groupColour(groups, name) {
  const at = groups.indexOf(name);
  if (groups.length <= GROUP_COLOURS.length) return GROUP_COLOURS[at];
  return `hsl(${Math.round(360 * at / groups.length)} 65% ${at % 2 ? 45 : 65}%)`;
}

// Ink that is read best on a colour, by relative luminance.
function inkOn([r, g, b]) {
  const [lr, lg, lb] = [r, g, b].map((c) => ((c / 255) <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * lr + 0.7152 * lg + 0.0722 * lb > 0.18 ? "#15202b" : "#ffffff";
}

class PlateMap {
  constructor(plate, data) {
    Object.assign(this, { plate, data });
    this.size = plate.columns <= 12 ? 60 : plate.columns <= 24 ? 38 : 22;
    const width = plate.columns * this.size + EDGE + 2, height = plate.rows * this.size + EDGE + 2;
    this.svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "group",
      "aria-label": `Plate ${plate.name}` });
    for (let r = 0; r < plate.rows; r += 1) this.label(plate.row_names[r], EDGE / 2, this.y(r) + this.size / 2);
    for (let c = 0; c < plate.columns; c += 1) this.label(c + 1, this.x(c) + this.size / 2, EDGE / 2);
    for (let r = 0; r < plate.rows; r += 1) {
      for (let c = 0; c < plate.columns; c += 1) this.svg.append(this.square(r, c, { class: "empty" }));
    }
    this.wells = plate.wells.map((well) => {
      const link = well.report ? draw("a", { href: well.report }) : draw("g", { role: "img" });
      link.classList.add("well");
      link.setAttribute("tabindex", "-1");
      this.svg.append(link);
      return link;
    });
    this.wells[0]?.setAttribute("tabindex", "0");
    this.box = make("div", { class: "map" }, this.svg); // Chromium lets an SVG itself take the focus where it listens.
    this.box.addEventListener("keydown", (event) => this.move(event));
    this.box.addEventListener("focusin", (event) => this.stay(event.target.closest(".well")));
  }

  x(column) { return EDGE + column * this.size; }

  y(row) { return EDGE + row * this.size; }

  label(text, x, y) {
    const size = Math.min(12, 0.6 * this.size);
    this.svg.append(draw("text", { x, y, "font-size": size, class: "side", "text-anchor": "middle",
      "dominant-baseline": "central", "aria-hidden": "true" }, String(text)));
  }

  square(row, column, attributes) {
    return draw("rect", { x: this.x(column) + 1, y: this.y(row) + 1, width: this.size - 2, height: this.size - 2, rx: 3,
      ...attributes });
  }

  show(metric) {
    this.plate.wells.forEach((well, k) => {
      const [row, column] = well.place, told = this.told(well, metric), parts = [];
      const x = this.x(column) + 1, y = this.y(row) + 1, side = this.size - 2;
      const [value] = metric === GROUPS ? [null] : well.values[metric] ?? [null];
      if (metric === GROUPS) {
        parts.push(this.square(row, column, { fill: well.group ? groupColour(this.data.groups, well.group) : "none" }));
      } else if (value !== null) {
        const { low, high } = this.data.metrics[metric], shade = colour(RAMP, (value - low) / (high - low));
        parts.push(this.square(row, column, { fill: `rgb(${shade.join(",")})` }));
        if (this.size > 30) {
          parts.push(draw("text", { x: x + side / 2, y: y + side / 2, fill: inkOn(shade), "text-anchor": "middle",
            "dominant-baseline": "central", "font-size": this.size > 50 ? 14 : 10 }, written(value, 3)));
        }
      }
      if (well.state === "fail") parts.push(this.square(row, column, { fill: "url(#hatch)" }));
      if (well.state === "failed") {
        const [a, b] = [0.2 * side, 0.8 * side];
        parts.push(this.square(row, column, { fill: value === null && metric !== GROUPS ? "transparent" : "none" }),
          draw("path", { d: `M${x + a} ${y + a}L${x + b} ${y + b}M${x + b} ${y + a}L${x + a} ${y + b}`, class: "cross" }));
      }
      if (well.state === "review") {
        const c = 0.26 * side;
        parts.push(draw("path", { d: `M${x + side - c} ${y}h${c}v${c}z`, class: "corner" }));
      }
      if (parts.length === 0) parts.push(this.square(row, column, { fill: "transparent" }));
      this.wells[k].replaceChildren(...parts);
      this.wells[k].setAttribute("aria-label", told.replaceAll("\n", ", "));
      this.wells[k].dataset.tip = told;
    });
  }

  // What is said of a well: its name and group, its number, and its verdict or why there is none.
  told(well, metric) {
    const lines = [[well.name, well.group].filter(Boolean).join(", ")];
    if (metric !== GROUPS) {
      const { name, unit } = this.data.metrics[metric], [value, error] = well.values[metric] ?? [null, null];
      if (value !== null) lines.push(`${name}: ${withError(value, error)}${unit ? ` ${unit}` : ""}`);
    }
    return [...lines, ...well.told].join("\n");
  }

  stay(well) {
    if (!well) return;
    for (const other of this.wells) other.setAttribute("tabindex", other === well ? "0" : "-1");
  }

  // The nearest well in the direction of an arrow key, in the same row or column if there is one.
  move(event) {
    const ways = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }, way = ways[event.key];
    const at = this.wells.indexOf(event.target.closest(".well"));
    if (!way || at < 0) return;
    event.preventDefault();
    const [row, column] = this.plate.wells[at].place;
    const far = (well) => {
      const along = (well.place[0] - row) * way[0] + (well.place[1] - column) * way[1];
      const across = Math.abs((well.place[0] - row) * way[1]) + Math.abs((well.place[1] - column) * way[0]);
      return along > 0 ? along + 100 * across : Infinity;
    };
    const order = this.plate.wells.map((well, k) => [far(well), k]).sort((a, b) => a[0] - b[0]);
    if (order[0][0] < Infinity) this.wells[order[0][1]].focus();
  }
}

function drawScale(home, metric) {
  home.replaceChildren();
  const stops = RAMP.map((c, k) => draw("stop", { offset: k / (RAMP.length - 1), "stop-color": `rgb(${c.join(",")})` }));
  const bar = draw("svg", { width: 260, height: 14, "aria-hidden": "true" },
    draw("defs", {}, draw("linearGradient", { id: "ramp" }, ...stops)),
    draw("rect", { width: 260, height: 14, rx: 3, fill: "url(#ramp)" }));
  home.append(make("span", {}, written(metric.low, 3)), bar,
    make("span", {}, `${written(metric.high, 3)} ${metric.unit}`.trim()), make("span", { class: "note" }, metric.tip));
}

function drawGroups(home, groups) {
  home.replaceChildren(...groups.slice(0, 40).map((name) => make("span", { class: "group" },
    draw("svg", { width: 14, height: 14, "aria-hidden": "true" },
      draw("rect", { width: 14, height: 14, rx: 3, fill: groupColour(groups, name) })), name)));
}

function showPlates(data) {
  const home = byId("maps"), choose = byId("metric"), scale = byId("scale");
  const pattern = draw("pattern", { id: "hatch", width: 8, height: 8, patternUnits: "userSpaceOnUse",
    patternTransform: "rotate(45)" }, draw("rect", { width: 8, height: 8, class: "hatch-ground" }),
  draw("rect", { width: 2, height: 8, class: "hatch" }));
  home.append(draw("svg", { width: 0, height: 0, "aria-hidden": "true" }, draw("defs", {}, pattern)));
  const maps = data.plates.map((plate) => new PlateMap(plate, data));
  maps.forEach((map, k) => home.append(make("figure", {},
    make("figcaption", {}, data.plates[k].name || "Plate"), map.box)));
  data.metrics.forEach((metric, k) => choose.append(make("option", { value: k },
    metric.unit ? `${metric.name} (${metric.unit})` : metric.name)));
  if (data.groups.length) choose.append(make("option", { value: GROUPS }, "Groups"));
  const show = () => {
    const metric = choose.value === GROUPS ? GROUPS : Number(choose.value);
    if (metric === GROUPS) drawGroups(scale, data.groups);
    else if (data.metrics.length) drawScale(scale, data.metrics[metric]);
    for (const map of maps) map.show(metric);
  };
  choose.addEventListener("change", show);
  document.querySelector(".choice").hidden = false;
  byId("plate-tables").hidden = true;
  show();
}

const plateData = JSON.parse(byId("data").textContent);
if (plateData.plates) showPlates(plateData);
