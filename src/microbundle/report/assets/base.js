// Small helpers. All scripts of a page are one module, put together in order.

const SVG = "http://www.w3.org/2000/svg";

function make(name, attributes = {}, ...children) {
  return fitted(document.createElement(name), attributes, children);
}

function draw(name, attributes = {}, ...children) {
  return fitted(document.createElementNS(SVG, name), attributes, children);
}

function fitted(element, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined && value !== false) element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

const byId = (id) => document.getElementById(id);

function written(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size < 1e-4 || size >= 1e6 ? value.toExponential(digits - 1)
    : value.toFixed(Math.max(0, digits - 1 - Math.floor(Math.log10(size))));
  return text.replace("-", "−");
}

function withError(value, error) {
  if (value === null || value === undefined) return "not known";
  if (!error) return written(value);
  const places = Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(error))));
  return `${value.toFixed(places)} ± ${error.toFixed(places)}`.replace("-", "−");
}

// The smallest of 1, 2, 5, 10, ... times a power of ten that is at least `size`.
function nice(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= size * 0.9999);
}

function ticks(low, high, count) {
  const step = nice((high - low) / Math.max(1, count));
  const out = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n += 1) out.push(n * step);
  const places = Math.max(0, Math.min(9, -Math.floor(Math.log10(step) + 1e-9)));
  return out.map((value) => [value, value.toFixed(places).replace("-", "−")]);
}

// Definitions show where they are pointed at or focused.
function showTips() {
  const tip = byId("tip");
  const show = (event) => {
    const term = event.target.closest?.("[data-tip]");
    if (!term) return;
    tip.textContent = term.dataset.tip;
    tip.hidden = false;
    term.setAttribute("aria-describedby", "tip");
    const box = term.getBoundingClientRect();
    tip.style.left = `${Math.max(8, Math.min(box.left, innerWidth - tip.offsetWidth - 8))}px`;
    const below = box.bottom + 8;
    tip.style.top = `${below + tip.offsetHeight < innerHeight ? below : Math.max(8, box.top - tip.offsetHeight - 8)}px`;
  };
  const hide = () => { tip.hidden = true; };
  for (const event of ["mouseover", "focusin"]) document.addEventListener(event, show);
  for (const event of ["mouseout", "focusout", "scroll"]) document.addEventListener(event, hide, true);
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });
}

// The colours of viridis, and the colour at a share of a ramp.
const RAMP = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121],
  [109, 205, 89], [180, 222, 44], [253, 231, 37]];

function colour(ramp, share) {
  const at = Math.max(0, Math.min(1, share)) * (ramp.length - 1), i = Math.min(ramp.length - 2, Math.floor(at));
  return ramp[i].map((one, c) => Math.round(one + (at - i) * (ramp[i + 1][c] - one)));
}

// What several widgets share: the frame, the sub-domain, the range of time. Listeners hear of every change.
class State {
  constructor(values) {
    this.values = values;
    this.listeners = [];
  }

  listen(listener) {
    this.listeners.push(listener);
  }

  set(changes) {
    const changed = new Set(Object.keys(changes).filter((key) => this.values[key] !== changes[key]));
    if (changed.size === 0) return;
    Object.assign(this.values, changes);
    for (const listener of this.listeners) listener(changed);
  }
}
