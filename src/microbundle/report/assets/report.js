// The report's widgets: map, traces, beats, loop and tables, which share the frame and the chosen sub-domain.

const data = JSON.parse(byId("data").textContent);
const frames = data.time.length;
const tiles = data.strain ? data.strain.labels.map((_, s) => s).filter((s) => !data.strain.reasons[s]) : [];
const whole = data.beats.filter((beat) => beat.complete);
const best = [...(whole.length ? whole : data.beats)][0];

const state = new State({ frame: best ? best.peak : 0, tile: strongest(), quantity: null, signal: null });
const time = new State({ low: null, high: null });
const maps = new Maps(data);

function strongest() {
  if (!tiles.length) return null;
  const at = data.strain.E.cc[best ? best.peak : 0];
  return tiles.reduce((a, b) => ((at[b] ?? 0) < (at[a] ?? 0) ? b : a));
}

const timeText = (frame) => `frame ${frame}${data.time_unit === "s" ? `, ${data.time[frame].toFixed(3)} s` : ""}`;
const course = (tile) => data.strain.E.cc.map((frame) => frame[tile]);
const courseError = (tile) => data.strain.se?.map((frame) => frame[tile]) ?? null;

function options(select, listed, chosen) {
  select.replaceChildren(...listed.map(([value, text]) => make("option", { value, selected: value === chosen }, text)));
}

// --- map ------------------------------------------------------------------------------------------------------------

function startMap() {
  const canvas = document.querySelector("#stage canvas");
  canvas.id = "map";
  const slider = byId("frame"), play = byId("play"), quantity = byId("quantity"), tile = byId("tile");
  slider.max = frames - 1;
  const first = maps.quantities[0]?.id ?? "none";
  state.values.quantity = first;
  options(quantity, [...maps.quantities.map((q) => [q.id, q.name]), ["none", "Picture alone"]], first);
  options(tile, tiles.length ? tiles.map((s) => [`${s}`, data.strain.labels[s]]) : [["", "none has strain"]],
    `${state.values.tile}`);
  tile.disabled = !tiles.length;
  const arrows = byId("show-arrows");
  arrows.disabled = !maps.grid;

  const paint = () => {
    const { frame } = state.values, shown = maps.quantities.find((q) => q.id === state.values.quantity);
    maps.paint(canvas, shown, frame);
    const drawn = arrows.checked ? maps.arrows(frame) : { path: "", times: 1 };
    document.querySelector("#stage .arrows").setAttribute("d", drawn.path);
    const bar = byId("bar"), scale = shown && maps.scale(shown);
    bar.style.visibility = shown ? "visible" : "hidden";
    if (shown) {
      bar.querySelector(".low").textContent = scale.low;
      bar.querySelector(".high").textContent = scale.high;
      bar.querySelector(".ramp").style.background = `linear-gradient(to right, ${scale.stops})`;
    }
    const thinned = shown?.of === "grid" && maps.grid.every > 1 ? ` The map shows every ${maps.grid.every}. frame.` : "";
    const grown = arrows.checked ? ` Arrows are drawn ${written(drawn.times, 2)} times too long.` : "";
    byId("map-note").textContent = `${shown ? `Colours mean the same in every frame.` : ""}${thinned}${grown}`;
    slider.value = frame;
    slider.setAttribute("aria-valuetext", timeText(frame));
    byId("when").textContent = timeText(frame);
  };
  slider.addEventListener("input", () => state.set({ frame: Number(slider.value) }));
  quantity.addEventListener("change", () => state.set({ quantity: quantity.value }));
  tile.addEventListener("change", () => state.set({ tile: Number(tile.value) }));
  arrows.addEventListener("change", paint);
  byId("show-outlines").addEventListener("change", (event) => {
    byId("stage").classList.toggle("bare", !event.target.checked);
  });
  state.listen((changed) => { if (changed.has("frame") || changed.has("quantity")) paint(); });
  new ResizeObserver(paint).observe(byId("stage"));
  startPlayer(play);
  startTiles(tile);
  paint();
}

function startPlayer(play) {
  let running = null;
  const stop = () => {
    cancelAnimationFrame(running);
    running = null;
    play.textContent = "▶";
    play.setAttribute("aria-label", "Play");
  };
  const perSecond = data.time_unit === "s" ? 1 : 25;
  play.addEventListener("click", () => {
    if (running !== null) return stop();
    play.textContent = "❚❚";
    play.setAttribute("aria-label", "Pause");
    const end = data.time[frames - 1], from = state.values.frame === frames - 1 ? 0 : data.time[state.values.frame];
    let began = null;
    const step = (now) => {
      began ??= now;
      const at = (from + (now - began) / 1000 * perSecond) % (end + (end / frames || 1));
      state.set({ frame: nearest(data.time, at) });
      running = requestAnimationFrame(step);
    };
    running = requestAnimationFrame(step);
    return undefined;
  });
  byId("frame").addEventListener("pointerdown", stop);
}

function startTiles(select) {
  const drawn = [...document.querySelectorAll("#stage .tile")];
  const choose = (s) => { if (tiles.includes(s)) state.set({ tile: s }); };
  const mark = () => {
    for (const one of drawn) {
      const s = Number(one.dataset.tile), chosen = s === state.values.tile;
      one.classList.toggle("chosen", chosen);
      if (!tiles.includes(s)) continue;
      one.setAttribute("aria-pressed", chosen);
      one.setAttribute("tabindex", chosen ? 0 : -1);
    }
    drawn.find((one) => one.classList.contains("chosen"))?.parentNode.append(
      drawn.find((one) => one.classList.contains("chosen")));
    select.value = `${state.values.tile}`;
  };
  for (const one of drawn) {
    const s = Number(one.dataset.tile);
    if (!tiles.includes(s)) continue;
    one.setAttribute("role", "button");
    one.setAttribute("aria-label", `sub-domain ${data.strain.labels[s]}`);
    one.addEventListener("click", () => choose(s));
    one.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: data.strain.cols, ArrowUp: -data.strain.cols }[event.key];
      if (!step) return;
      event.preventDefault();
      choose(state.values.tile + step);
      drawn.find((other) => Number(other.dataset.tile) === state.values.tile).focus();
    });
  }
  state.listen((changed) => { if (changed.has("tile")) mark(); });
  mark();
}

// Maps at the peak of the first whole beat, for the printed page.
function startPeakMaps() {
  const shown = maps.quantities.filter((q) => ["size", "cc"].includes(q.id));
  if (!best) return;
  for (const quantity of shown) {
    const stage = make("div", { class: "stage" });
    const under = document.querySelector("#stage .under").cloneNode(true), over = document.querySelector("#stage .over")
      .cloneNode(true);
    over.querySelectorAll("[tabindex], [role]").forEach((one) => { one.removeAttribute("tabindex"); one.removeAttribute("role"); });
    over.querySelectorAll(".chosen").forEach((one) => one.classList.remove("chosen"));
    over.querySelector(".arrows").remove();
    const canvas = make("canvas");
    stage.append(under, canvas, over);
    const scale = maps.scale(quantity), ramp = make("span", { class: "ramp" });
    ramp.style.background = `linear-gradient(to right, ${scale.stops})`;
    const bar = make("div", { class: "bar" }, make("span", {}, scale.low), ramp, make("span", {}, scale.high));
    byId("peak-maps").append(make("figure", {}, stage, bar, make("figcaption", {},
      `${quantity.name}, at the peak of beat ${data.beats.indexOf(best) + 1} (${timeText(best.peak)})`)));
    maps.paint(canvas, quantity, best.peak);
  }
}

// --- traces ---------------------------------------------------------------------------------------------------------

const step = frames > 1 ? (data.time[frames - 1] - data.time[0]) / (frames - 1) : 1;
const bands = data.beats.map((beat) => ({ from: data.time[beat.start], to: data.time[Math.min(frames - 1, beat.stop)],
  peak: data.time[beat.peak], complete: beat.complete }));
const xLabel = data.time_unit === "s" ? "time, s" : "time, frames";
const ALL = "strain";

function lines(signal, tile) {
  return signal.lines.map((line, i) => ({ ...line, x: data.time, colour: i + 1, tile }));
}

function strainLines(tile) {
  const others = tiles.filter((s) => s !== tile).map((s) => ({ name: data.strain.labels[s], x: data.time, y: course(s),
    se: null, colour: 0 }));
  return [...others, { name: data.strain.labels[tile], x: data.time, y: course(tile), se: courseError(tile), colour: 1 }];
}

const strainTitle = (tile) => `Strain E_cc of ${data.strain.labels[tile]}`;
const greyTitle = (tile) => `${strainTitle(tile)}${tiles.length > 1 ? " (grey: the others)" : ""}`;

function startTraces() {
  const common = { range: time, xLabel, xUnit: data.time_unit, beats: bands, step,
    cursor: () => data.time[state.values.frame], pick: (x) => state.set({ frame: nearest(data.time, x) }),
    where: (x) => timeText(nearest(data.time, x)) };
  const charts = data.signals.map((signal) => new Chart(byId("traces"), { ...common, id: signal.id, title: signal.title,
    unit: signal.unit, lines: lines(signal) }));
  if (tiles.length) {
    const { tile } = state.values;
    const chart = new Chart(byId("traces"), { ...common, id: ALL, title: greyTitle(tile), unit: "", lines: strainLines(tile) });
    charts.splice(2, 0, chart);
    const after = charts[1]?.root;
    if (after) after.after(chart.root);
    state.listen((changed) => {
      if (changed.has("tile")) chart.show(strainLines(state.values.tile), greyTitle(state.values.tile));
    });
  }
  state.listen((changed) => { if (changed.has("frame")) for (const chart of charts) chart.moveCursor(); });
  const [chart] = charts;
  if (!chart) return;
  const actions = { in: () => chart.zoom(0.5), out: () => chart.zoom(2), left: () => chart.pan(-0.3),
    right: () => chart.pan(0.3), all: () => chart.setRange(null, null) };
  for (const [name, act] of Object.entries(actions)) byId(`zoom-${name}`).addEventListener("click", act);
}

// --- beats, one over the other --------------------------------------------------------------------------------------

function startOverlay() {
  const host = byId("overlay"), select = byId("signal");
  if (!data.beats.length) {
    select.closest(".controls").remove();
    return;
  }
  const found = data.signals.flatMap((signal) => signal.lines.map((line) => ({ title: signal.lines.length > 1
    ? `${signal.title}, ${line.name}` : signal.title, unit: signal.unit, line })));
  const listed = found.map((one, i) => [`${i}`, one.title]);
  if (tiles.length) listed.push([ALL, "Strain E_cc of the chosen sub-domain"]);
  options(select, listed, "0");
  const chosen = () => {
    if (select.value !== ALL) return found[Number(select.value)];
    const { tile } = state.values;
    return { title: strainTitle(tile), unit: "", line: { y: course(tile), se: courseError(tile) } };
  };
  const cut = (line) => data.beats.map((beat, b) => {
    const stop = Math.min(frames, beat.stop + 1), part = (list) => list?.slice(beat.start, stop) ?? null;
    return { name: beat.name, x: part(data.time).map((t) => t - beat.time),
      y: part(line.y), se: part(line.se), colour: b % 6 + 1, cut: !beat.complete };
  });
  const { title, unit, line } = chosen();
  const chart = new Chart(host, { range: new State({ low: null, high: null }), id: "overlay", height: 260, title, unit,
    lines: cut(line), step, xLabel: `time from the peak, ${data.time_unit}`, xUnit: data.time_unit });
  const renew = () => {
    const now = chosen();
    chart.unit = now.unit;
    chart.show(cut(now.line), now.title);
  };
  select.addEventListener("change", renew);
  state.listen((changed) => { if (changed.has("tile") && select.value === ALL) renew(); });
}

function startLoop() {
  if (!data.loop || !whole.length) return;
  const drawn = data.beats.flatMap((beat, b) => (beat.complete ? [{ name: `beat ${b + 1}`, colour: b % 6 + 1, se: null,
    x: data.loop.x.slice(beat.start, beat.stop + 1), y: data.loop.y.slice(beat.start, beat.stop + 1) }] : []));
  new Chart(byId("loop"), { range: new State({ low: null, high: null }), id: "loop", height: 300, title: data.loop.title,
    unit: data.loop.unit, lines: drawn, free: true, xLabel: "fractional shortening", xUnit: "shortening" });
}

// --- tables and text ------------------------------------------------------------------------------------------------

function startTabs() {
  const tabs = [...document.querySelectorAll("[role=tab]")];
  const open = (chosen) => {
    for (const tab of tabs) {
      const is = tab === chosen;
      tab.setAttribute("aria-selected", is);
      tab.setAttribute("tabindex", is ? 0 : -1);
      byId(tab.getAttribute("aria-controls")).hidden = !is;
    }
  };
  for (const [i, tab] of tabs.entries()) {
    tab.addEventListener("click", () => open(tab));
    tab.addEventListener("keydown", (event) => {
      const to = { ArrowRight: i + 1, ArrowLeft: i - 1, Home: 0, End: tabs.length - 1 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      const next = tabs[(to + tabs.length) % tabs.length];
      open(next);
      next.focus();
    });
  }
  open(tabs[0]);
}

function startCopy() {
  byId("copy").addEventListener("click", async () => {
    const text = byId("methods-text");
    const works = [...text.querySelectorAll("li")].map((work, i) => `[${i + 1}] ${work.textContent}`);
    try {
      await navigator.clipboard.writeText([text.querySelector("p").textContent, ...works].join("\n"));
      byId("copied").textContent = "Copied.";
    } catch {
      getSelection().selectAllChildren(text);
      byId("copied").textContent = "Selected; copy it with Ctrl-C or ⌘C.";
    }
  });
}

document.documentElement.classList.add("live");
showTips();
startMap();
startPeakMaps();
startTraces();
startOverlay();
startLoop();
startTabs();
startCopy();
