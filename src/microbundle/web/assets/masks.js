// The masks of a movie: what the program finds and how far it trusts it, and tools to change it, with a live preview.

import { post } from "./api.js";
import { AxisTool, axisEnds } from "./axis.js";
import { BrushTool } from "./brush.js";
import { DrawTool } from "./drawing.js";
import { History } from "./history.js";
import { AUTOMATIC, decided, stateOf, strainOf, withoutMasks } from "./mask_state.js";
import { OutlineTool, ringPath } from "./outline.js";
import { Raster, unpacked } from "./raster.js";
import { draw, make } from "./shared.js";
import { TilesTool } from "./tiles.js";
import { Viewer } from "./viewer.js";
import { VERDICTS, button, does, drafts, say, soon, trouble } from "./page.js";

const TINTS = { tissue: [86, 180, 255], pillar: [92, 225, 255] };
const METHODS = [
  ["auto", "Chosen by the program"],
  ["otsu", "Otsu, on a frame"],
  ["sobel", "Sobel, on a frame"],
  ["minimum", "Darkest value of each pixel"],
  ["maximum", "Brightest value of each pixel"],
];
const TOOLS = [
  ["look", "Look", null],
  ["corners", "Corners", OutlineTool],
  ["draw", "Draw", DrawTool],
  ["paint", "Paint", BrushTool],
  ["erase", "Erase", BrushTool],
  ["axis", "Axis", AxisTool],
  ["tiles", "Sub-domains", TilesTool],
];
const HINTS = {
  look: "What the program found. Choose a tool to change it.",
  corners:
    "Drag a corner, or press an edge to add one. By keys: Tab to a corner, arrows move it, N next, P previous, " +
    "Insert adds, Delete removes.",
  draw: "Click corner after corner; double click, Enter or the first corner closes the outline. Esc gives it up.",
  paint: "Drag to add. By keys: arrows move the cross, space paints.",
  erase: "Drag to take away. By keys: arrows move the cross, space erases.",
  axis: "Drag an end of the axis to turn it, or tab to it and use the arrow keys.",
  tiles:
    "Drag the rectangle that is divided, or its sides; a margin stays free. By keys: tab to a side, arrows move it.",
};

export async function startMasks(panel, movie) {
  const editor = new Editor(panel, movie, await stateOf(movie));
  await editor.preview();
  return { refresh: () => editor.showSaved() };
}

class Editor {
  constructor(panel, movie, saved) {
    Object.assign(this, {
      movie,
      saved,
      target: "tissue",
      tool: null,
      toolName: "look",
      answer: null,
      rasters: new Map(),
      brushPx: 8,
    });
    this.draftKey = `masks ${movie.run} ${movie.key}`;
    const draft = drafts.get(this.draftKey);
    this.history = new History(draft ?? saved, () => this.changed());
    this.build(panel);
    this.soon = soon(120, () => this.preview());
    if (draft) say("Your unsaved changes are back.");
    document.addEventListener("keydown", (event) => {
      if (
        panel.hidden ||
        !(event.ctrlKey || event.metaKey) ||
        !["z", "y", "Z"].includes(event.key) ||
        /^(INPUT|TEXTAREA)$/.test(event.target.tagName)
      )
        return;
      event.preventDefault();
      if (event.key === "y" || event.shiftKey) this.history.redo();
      else this.history.undo();
    });
    this.choose("look");
  }

  get state() {
    return this.history.now;
  }

  get axis() {
    return this.answer?.axis ?? null;
  }

  get extents() {
    return this.state.extents_px ?? this.answer?.extents_px ?? null;
  }

  // --- page --------------------------------------------------------------------------------------------------------

  build(panel) {
    this.tools = make(
      "div",
      { class: "switch", role: "group", "aria-label": "Tool" },
      ...TOOLS.map(([name, label]) => {
        const pressed = make("button", { type: "button", "aria-pressed": "false" }, label);
        pressed.dataset.tool = name;
        pressed.addEventListener("click", () => this.choose(name));
        return pressed;
      }),
    );
    this.targets = make("select", {});
    this.targets.addEventListener("change", () => this.aim(this.targets.value));
    this.brush = make("input", { type: "range", min: 1, max: 60, value: this.brushPx });
    this.brush.addEventListener("input", () => {
      this.brushPx = Number(this.brush.value);
    });
    this.brushLabel = make("label", { hidden: true }, "Brush ", this.brush);
    [this.undo, this.redo] = ["undo", "redo"].map((way) => {
      const pressed = make("button", { type: "button" }, way === "undo" ? "Undo" : "Redo");
      pressed.addEventListener("click", () => this.history[way]());
      return pressed;
    });
    this.hint = make("p", { class: "note", id: "mask-hint" });
    const left = make("div");
    this.verdict = make("p", { class: "verdict" });
    this.findings = make("ul", { class: "told" });
    this.numbers = make("dl", { class: "facts" });
    this.method = make("select", {}, ...METHODS.map(([value, text]) => make("option", { value }, text)));
    this.method.addEventListener("change", () =>
      this.set({ method: this.method.value, frame: this.viewer.frame, tissue: null }),
    );
    this.counts = ["Across", "Along"].map((name) =>
      make("input", { type: "number", min: 1, max: 50, "aria-label": `Sub-domains ${name.toLowerCase()}` }),
    );
    for (const input of this.counts) {
      input.addEventListener("change", () => {
        const counts = this.counts.map((one) => Number(one.value));
        if (counts.every((n) => Number.isInteger(n) && n > 0)) this.set({ tiles: counts });
      });
    }
    this.save = make("button", { type: "button", class: "main" }, "Use these masks");
    this.save.addEventListener("click", () => does(this.save, () => this.keep()));
    this.discard = button("Back to what is saved", () => this.history.push(this.saved));
    this.drop = button("Take this pillar away", () => this.dropPillar());
    this.automatic = button("Automatic again", () => this.history.push({ ...AUTOMATIC }));
    this.unsaved = make("p", { class: "note", role: "status" });
    panel.replaceChildren(
      make(
        "div",
        { class: "controls" },
        make("label", {}, "Change ", this.targets),
        this.tools,
        this.brushLabel,
        this.undo,
        this.redo,
      ),
      this.hint,
      make(
        "div",
        { class: "beside" },
        left,
        make(
          "div",
          { class: "side" },
          this.verdict,
          this.findings,
          this.numbers,
          make(
            "div",
            { class: "pair-of" },
            make("label", {}, "Tissue found by ", this.method),
            make("span", {}, "Sub-domains ", ...[this.counts[0], " × ", this.counts[1]]),
          ),
          make("p", { class: "choices" }, this.drop, this.automatic, this.discard),
          make("p", { class: "choices" }, this.save),
          this.unsaved,
        ),
      ),
    );
    this.viewer = new Viewer(left, {
      base: this.movie.base,
      info: this.movie.info,
      label: "Picture with masks",
      state: this.movie.frame,
    });
    this.viewer.stage.setAttribute("aria-describedby", "mask-hint");
    this.viewer.resized = () => this.tool?.render();
    this.layer = draw("g", { class: "masks", "aria-hidden": "true" });
    this.viewer.over.append(this.layer);
  }

  choose(name) {
    this.tool?.stop();
    this.toolName = name;
    const [, , Tool] = TOOLS.find(([one]) => one === name);
    this.tool = Tool ? new Tool(this, name === "paint" ? 1 : 0) : null;
    for (const pressed of this.tools.children) pressed.setAttribute("aria-pressed", pressed.dataset.tool === name);
    this.brushLabel.hidden = !["paint", "erase"].includes(name);
    this.hint.textContent = HINTS[name];
    this.viewer.root.dataset.tool = name;
    this.tool?.start();
    this.show();
  }

  aim(name) {
    if (name === "new") {
      const own = { ...this.pillarRuns() };
      let n = 1;
      while (own[`pillar_${n}`]) n += 1;
      this.target = `pillar_${n}`;
      this.choose("draw");
      return;
    }
    this.target = name;
    this.choose(this.toolName);
  }

  // --- masks -------------------------------------------------------------------------------------------------------

  raster() {
    return this.rasters.get(this.target) ?? new Raster(this.movie.info.rows, this.movie.info.cols);
  }

  // What tells one mask of the target from another: its runs, or the answer they were found in.
  mask() {
    return (this.target === "tissue" ? this.state.tissue : this.state.pillars?.[this.target]) ?? this.answer;
  }

  polygons() {
    if (this.target === "tissue") return [...(this.answer?.tissue ?? []), ...(this.answer?.holes ?? [])];
    const pillar = this.answer?.pillars.find((one) => one.name === this.target);
    return pillar ? rings(pillar.polygon) : [];
  }

  pillarRuns() {
    return (
      this.state.pillars ??
      Object.fromEntries((this.answer?.pillars ?? []).map((one) => [one.name, this.rasters.get(one.name).runs]))
    );
  }

  setMask(raster) {
    if (raster.empty) {
      say("That would leave nothing of the mask.");
      trouble("That would leave nothing of this mask; it stays as it was.");
      this.show();
      return this.mask();
    }
    const { runs } = raster;
    this.rasters.set(this.target, raster);
    this.set(this.target === "tissue" ? { tissue: runs } : { pillars: { ...this.pillarRuns(), [this.target]: runs } });
    return runs;
  }

  dropPillar() {
    const { [this.target]: gone, ...rest } = this.pillarRuns();
    if (this.target === "tissue" || !gone) return;
    this.target = "tissue";
    this.set({ pillars: rest });
  }

  setAxis(degrees) {
    this.set({ axis_deg: degrees });
  }

  tellAngle(degrees) {
    this.fact("angle", `${degrees.toFixed(1)}°`);
  }

  setExtents(extents) {
    this.set({ extents_px: extents });
  }

  set(change) {
    this.history.push({ ...this.state, ...change });
  }

  changed() {
    drafts.set(this.draftKey, this.isSaved ? null : this.state);
    this.show();
    this.soon();
  }

  get isSaved() {
    return JSON.stringify(this.state) === JSON.stringify(this.saved);
  }

  // --- preview -----------------------------------------------------------------------------------------------------

  async preview() {
    this.asking?.abort();
    const asking = (this.asking = new AbortController()),
      { state } = this,
      { rows, cols } = this.movie.info;
    const png = (runs) => Raster.fromRuns(runs, rows, cols).toPng();
    const asked = { method: state.method, frame: state.frame, axis_deg: state.axis_deg, strain: strainOf(state) };
    if (state.tissue) asked.tissue_png = png(state.tissue);
    if (state.pillars)
      asked.pillar_pngs = Object.fromEntries(Object.entries(state.pillars).map(([name, runs]) => [name, png(runs)]));
    this.side(true);
    try {
      const answer = await post(`${this.movie.base}/masks`, asked, { signal: asking.signal });
      const rasters = new Map();
      if (answer.tissue_png) rasters.set("tissue", await Raster.fromPng(unpacked(answer.tissue_png), rows, cols));
      for (const one of answer.pillars) rasters.set(one.name, await Raster.fromPng(unpacked(one.png), rows, cols));
      if (asking.signal.aborted) return;
      Object.assign(this, { answer, rasters });
      this.side(false);
      this.show();
    } catch (error) {
      if (asking === this.asking) this.side(false);
      trouble(error);
    }
  }

  side(waiting) {
    this.numbers.parentNode.setAttribute("aria-busy", waiting);
  }

  tint(raster) {
    raster.paint(this.viewer.tint, TINTS[this.target === "tissue" ? "tissue" : "pillar"]);
  }

  show() {
    this.undo.setAttribute("aria-disabled", !this.history.canUndo);
    this.redo.setAttribute("aria-disabled", !this.history.canRedo);
    this.showSaved();
    const { answer } = this;
    if (!answer) return;
    const names = [
      "tissue",
      ...new Set([...answer.pillars.map((one) => one.name), ...(this.target === "tissue" ? [] : [this.target])]),
    ];
    this.targets.replaceChildren(
      ...names.map((name) => make("option", { value: name, selected: name === this.target }, named(name))),
      make("option", { value: "new" }, "A new pillar …"),
    );
    this.drop.hidden = this.target === "tissue";
    this.method.value = this.state.method;
    this.method.parentNode.hidden = this.state.tissue !== null;
    const grid = answer.grid ?? ["", ""];
    this.counts.forEach((input, i) => {
      if (document.activeElement !== input) input.value = this.state.tiles?.[i] ?? grid[i];
    });
    this.showVerdict();
    this.showLayer();
    const editing = ["corners", "paint", "erase"].includes(this.toolName);
    if (editing) this.tint(this.raster());
    else this.viewer.tint.getContext("2d").clearRect(0, 0, this.viewer.tint.width, this.viewer.tint.height);
    this.tool?.render();
  }

  showSaved() {
    this.save.disabled = this.isSaved;
    this.discard.hidden = this.isSaved;
    this.unsaved.textContent = this.isSaved
      ? ""
      : "Not yet used. They are kept in this browser until you use or discard them.";
  }

  showVerdict() {
    const { verdict, findings, stability, method, axis, pillars } = this.answer;
    const words = { pass: "The mask looks right.", review: "Look at the mask.", fail: "There is no mask to trust." };
    this.verdict.className = `verdict ${verdict}`;
    this.verdict.replaceChildren(make("strong", {}, VERDICTS[verdict]), make("span", {}, words[verdict]));
    this.findings.replaceChildren(...findings.map((one) => make("li", { class: one.level }, one.message)));
    const facts = [
      ["made by", this.state.tissue ? "you" : method === "supplied" ? "the file that came with the movie" : method],
      ["stability", stability === null || stability === undefined ? null : `${Math.round(100 * stability)} % overlap`],
      ["length", axis && `${Math.round(axis.length_px)} px`],
      ["width", axis && `${Math.round(axis.width_px)} px`],
      ["angle", axis && `${axis.angle_deg.toFixed(1)}°${this.state.axis_deg === null ? "" : " (yours)"}`],
      ["pillars", pillars.length ? pillars.map((one) => `${named(one.name)}: ${one.source}`).join("; ") : "none"],
      ["sub-domains", `${this.answer.tiles.length}`],
    ];
    this.numbers.replaceChildren(
      ...facts
        .filter(([, value]) => value)
        .flatMap(([name, value]) => {
          const told = make("dd", {}, value);
          told.dataset.fact = name;
          return [make("dt", {}, name), told];
        }),
    );
  }

  fact(name, text) {
    const found = this.numbers.querySelector(`[data-fact="${name}"]`);
    if (found) found.textContent = text;
  }

  showLayer() {
    const { tissue, holes, pillars, axis, tiles, tile_labels: labels } = this.answer,
      parts = [];
    const own = this.toolName === "corners";
    if (!(own && this.target === "tissue"))
      parts.push(draw("path", { class: "tissue", d: ringPath([...tissue, ...holes]) }));
    for (const one of pillars) {
      if (!(own && this.target === one.name))
        parts.push(draw("path", { class: "pillar", d: ringPath(rings(one.polygon)) }));
    }
    if (axis && this.toolName !== "axis")
      parts.push(
        draw("path", {
          class: "axis",
          d: `M${axisEnds(axis)
            .map(([r, c]) => `${c + 0.5} ${r + 0.5}`)
            .join("L")}`,
        }),
      );
    tiles.forEach((corners, i) => {
      parts.push(draw("path", { class: "tile", d: ringPath([corners]) }));
      if (tiles.length <= 40) {
        const mean = (k) => corners.reduce((sum, one) => sum + one[k], 0) / 4 + 0.5;
        const size = 0.3 * Math.hypot(corners[1][0] - corners[0][0], corners[1][1] - corners[0][1]);
        parts.push(
          draw("text", { x: mean(1), y: mean(0), "font-size": Math.min(size, 13 / this.viewer.scale) }, labels[i]),
        );
      }
    });
    this.layer.replaceChildren(...parts);
  }

  // --- saving ------------------------------------------------------------------------------------------------------

  async keep() {
    const { state } = this,
      made = decided(state, this.movie.info, this.movie.sign());
    await this.movie.save((decisions) => [...withoutMasks(decisions), ...made.decisions], made.masks);
    this.saved = state;
    drafts.set(this.draftKey, null);
    this.showSaved();
    say("Kept. Measure the movie again to use them.");
  }
}

export const named = (name) => (name === "tissue" ? "Tissue" : name.replace("pillar_", "Pillar "));

// A mask's outline may be one ring or several.
export const rings = (polygon) => (polygon.length && Array.isArray(polygon[0][0]) ? polygon : [polygon]);
