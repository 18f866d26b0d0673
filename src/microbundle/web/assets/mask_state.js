// What a person decided on masks, as one state for undo and redo; and its way from and into the list of decisions.
// A state is {method, frame, tissue, pillars, axis_deg, extents_px, tiles}: masks as lengths of runs, null for what the
// program finds by itself; `pillars` is null or an object by name, empty for none.

import { picture } from "./api.js";
import { Raster } from "./raster.js";

export const AUTOMATIC = {
  method: "auto",
  frame: 0,
  tissue: null,
  pillars: null,
  axis_deg: null,
  extents_px: null,
  tiles: null,
};
const STRAIN = ["extents_px", "tiles"];

export async function stateOf(movie) {
  const state = { ...AUTOMATIC },
    { rows, cols } = movie.info;
  for (const one of movie.decisions) {
    if (one.kind === "use_mask") {
      const png = await picture(`${movie.base}/masks/${one.name}`),
        { runs } = await Raster.fromPng(png, rows, cols);
      if (one.name === "tissue") state.tissue = runs;
      else state.pillars = { ...state.pillars, [one.name]: runs };
    } else if (one.kind === "settings") {
      const { mask, pillars, axis_deg: axis, strain } = one.settings;
      state.method = mask?.method ?? state.method;
      state.frame = mask?.frame ?? state.frame;
      state.axis_deg = axis ?? state.axis_deg;
      state.extents_px = strain?.extents_px ?? state.extents_px;
      state.tiles = strain?.tiles ?? state.tiles;
      if (pillars?.masks === "none") state.pillars ??= {};
    }
  }
  return state;
}

// The settings that a state asks for, nested as in a file of settings.
export function settingsOf(state) {
  const out = {};
  if (state.method !== "auto") {
    out.mask = { method: state.method, ...(["otsu", "sobel"].includes(state.method) ? { frame: state.frame } : {}) };
  }
  if (state.pillars && !Object.keys(state.pillars).length) out.pillars = { masks: "none" };
  if (state.axis_deg !== null) out.axis_deg = state.axis_deg;
  const strain = strainOf(state);
  if (Object.keys(strain).length) out.strain = strain;
  return out;
}

export const strainOf = ({ extents_px: extents, tiles }) => ({
  ...(extents ? { extents_px: extents } : {}),
  ...(tiles ? { tiles } : {}),
});

// Older decisions without what is decided anew here.
export function withoutMasks(decisions) {
  return decisions
    .filter((one) => one.kind !== "use_mask")
    .map((one) => {
      if (one.kind !== "settings") return one;
      const { mask, pillars, axis_deg: axis, strain, ...rest } = one.settings;
      const kept = (part, names) =>
        Object.fromEntries(Object.entries(part ?? {}).filter(([name]) => !names.includes(name)));
      const left = {
        pillars: kept(pillars, ["masks"]),
        strain: kept(strain, STRAIN),
        mask: kept(mask, ["method", "frame"]),
      };
      for (const [name, part] of Object.entries(left)) if (Object.keys(part).length) rest[name] = part;
      return { ...one, settings: rest };
    })
    .filter((one) => one.kind !== "settings" || Object.keys(one.settings).length);
}

export function decided(state, { rows, cols }, sign) {
  const settings = settingsOf(state),
    own = { ...(state.tissue ? { tissue: state.tissue } : {}), ...(state.pillars ?? {}) };
  const decisions = Object.keys(own).map((name) => ({ kind: "use_mask", name, ...sign }));
  if (Object.keys(settings).length) decisions.push({ kind: "settings", settings, ...sign });
  return {
    decisions,
    masks: Object.fromEntries(
      Object.entries(own).map(([name, runs]) => [name, Raster.fromRuns(runs, rows, cols).toPng()]),
    ),
  };
}
