// The form of all settings, made from the same texts as the command line's help. What is changed is kept at once.

import { get, ofRun, send } from "./api.js";
import { make } from "./shared.js";
import { say, soon, trouble, worded } from "./page.js";

const CALIBRATION = ["fps", "um_per_px"];
const FIRST = ["pillars.stiffness_un_per_um", "method"];
const SWITCHES = [
  ["figures", "figures", "Figures for a paper", "PNG and PDF of every kind for each movie (takes longer)."],
  ["movies", "movie_files", "Movies", "The beating tissue in colours, as MP4, for each movie (takes longer)."],
];

export const at = (tree, key) => key.split(".").reduce((part, name) => part?.[name], tree) ?? null;

// A copy of the settings with one changed; null takes it out.
export function changed(tree, key, value) {
  const [name, ...rest] = key.split("."),
    copy = { ...tree };
  if (rest.length) {
    copy[name] = changed(copy[name] ?? {}, rest.join("."), value);
    if (!Object.keys(copy[name]).length) delete copy[name];
  } else if (value === null) delete copy[name];
  else copy[name] = value;
  return copy;
}

const written = (value) =>
  value === null || value === undefined
    ? ""
    : Array.isArray(value)
      ? JSON.stringify(value).slice(1, -1).replaceAll(",", ", ")
      : `${value}`;

const hint = ({ key, default: standard }) =>
  CALIBRATION.includes(key) ? "from the file" : written(standard) || "not given";

// Sends one change after the other, each made of the run as it is by then, so that none undoes another.
export class Keeper {
  // `now()` gives the run as it is known; `heard` is called with the run after a change.
  constructor(run, now, heard) {
    Object.assign(this, { run, now, heard, last: Promise.resolve() });
  }

  // `change(run)` gives what is to be sent; `field` has the input and where to say what is wrong with it.
  send(field, change) {
    this.last = this.last.then(async () => {
      try {
        const run = await send("PATCH", ofRun(this.run), change(this.now()));
        tell(field, "");
        say("Kept.");
        this.heard(run);
      } catch (error) {
        if (error.status === 422) tell(field, error.message);
        else trouble(error);
      }
    });
    return this.last;
  }

  // Waits until a person has typed all of it.
  typed(field) {
    return soon(350, (change) => this.send(field, change));
  }
}

export const toSetting = (key, value) => (run) => ({ settings: changed(run.settings ?? {}, key, value) });

function tell({ input, wrong }, message) {
  wrong.textContent = message;
  if (message) input.setAttribute("aria-invalid", "true");
  else input.removeAttribute("aria-invalid");
}

export class SettingsForm {
  constructor(host, keeper) {
    Object.assign(this, { host, keeper, fields: new Map() });
  }

  async start() {
    const [app, sections] = await Promise.all([get("/api/app"), get("/api/settings")]);
    this.sections = sections;
    const all = this.sections.flatMap((section) => section.fields),
      first = FIRST.map((key) => all.find((one) => one.key === key));
    const calibration = this.sections[0].fields.filter((one) => CALIBRATION.includes(one.key));
    const names = make(
      "div",
      { class: "fields" },
      this.pattern(),
      ...(app.pictures ? SWITCHES : []).map((one) => this.flag(...one)),
    );
    this.host.replaceChildren(
      make("div", { class: "fields" }, ...[...calibration, ...first].filter(Boolean).map((one) => this.field(one))),
      make("details", {}, make("summary", {}, app.pictures ? "Names, and what is written" : "Names"), names),
      make(
        "details",
        {},
        make("summary", {}, "All other settings", make("span", { class: "note" }, "meant to be left alone")),
        ...this.sections.map((section) => this.section(section, [...calibration, ...first])).filter(Boolean),
      ),
    );
    this.show();
  }

  section({ title, text, fields }, shown) {
    const rest = fields.filter((one) => !shown.includes(one));
    if (!rest.length) return null;
    return make(
      "details",
      {},
      make("summary", {}, title),
      make("p", { class: "note" }, ...worded(text)),
      make("div", { class: "fields" }, ...rest.map((one) => this.field(one))),
    );
  }

  field(one) {
    const id = `set-${one.key.replaceAll(".", "-")}`;
    const common = { id, "aria-describedby": `${id}-help` };
    const input = one.choices?.length
      ? make("select", common, ...one.choices.map((choice) => make("option", { value: choice }, choice)))
      : one.type === "boolean"
        ? make("input", { ...common, type: "checkbox" })
        : ["number", "integer"].includes(one.type)
          ? make("input", {
              ...common,
              type: "number",
              step: one.type === "integer" ? 1 : "any",
              min: one.minimum ?? one.above ?? null,
              max: one.maximum ?? one.below ?? null,
              placeholder: hint(one),
            })
          : make("input", { ...common, type: "text", autocomplete: "off", placeholder: hint(one) });
    const wrong = make("p", { class: "wrong", role: "alert" }),
      set = make("span", { class: "set" });
    const entry = { ...one, input, wrong, set };
    this.fields.set(one.key, entry);
    const keep = this.keeper.typed(entry);
    input.addEventListener(one.choices?.length || one.type === "boolean" ? "change" : "input", () => {
      const value = this.read(entry);
      if (value === undefined) {
        tell(
          entry,
          `Expected ${
            one.type === "integer"
              ? "a whole number"
              : one.type === "number"
                ? "a number"
                : "numbers with commas between them"
          }.`,
        );
        return;
      }
      keep(toSetting(one.key, value));
    });
    const label = make(
      "label",
      { for: id },
      one.label,
      ...(one.unit ? [" ", make("span", { class: "unit" }, one.unit)] : []),
    );
    return (entry.host = make(
      "div",
      { class: "field" },
      one.type === "boolean" ? make("span", {}, input, label) : label,
      ...(one.type === "boolean" ? [] : [input]),
      set,
      wrong,
      make("p", { class: "help", id: `${id}-help` }, ...worded(one.text)),
    ));
  }

  // The value in a field: null for the default, undefined for what cannot be read.
  read({ input, type, choices, default: standard }) {
    if (type === "boolean") return input.checked === standard ? null : input.checked;
    if (choices?.length) return input.value === standard ? null : input.value;
    const text = input.value.trim();
    if (text === "") return input.validity?.badInput ? undefined : null;
    if (type === "number" || type === "integer") return Number.isFinite(Number(text)) ? Number(text) : undefined;
    if (type === "string") return text;
    try {
      return JSON.parse(`[${text.replace(/^\[(.*)\]$/s, type === "rows" && !text.startsWith("[[") ? "[$1]" : "$1")}]`);
    } catch {
      return undefined;
    }
  }

  pattern() {
    this.patternInput = make("input", {
      id: "set-pattern",
      type: "text",
      autocomplete: "off",
      placeholder: "{plate}_{well}",
      spellcheck: "false",
      "aria-describedby": "set-pattern-help",
    });
    this.patternWrong = make("p", { class: "wrong", role: "alert" });
    const keep = this.keeper.typed({ input: this.patternInput, wrong: this.patternWrong });
    this.patternInput.addEventListener("input", () =>
      keep(() => ({ pattern: this.patternInput.value.trim() || null })),
    );
    return make(
      "div",
      { class: "field" },
      make("label", { for: "set-pattern" }, "Names"),
      this.patternInput,
      this.patternWrong,
      make(
        "p",
        { class: "help", id: "set-pattern-help" },
        "How the names of the movies are built: {well} is like A1 or B12, {day} is a " +
          "number, any other part in {} becomes a column, and * is left out. / stands between folders.",
      ),
    );
  }

  flag(key, shown, label, help) {
    const input = make("input", { id: `set-${key}`, type: "checkbox", "aria-describedby": `set-${key}-help` });
    const wrong = make("p", { class: "wrong", role: "alert" });
    input.addEventListener("change", () => this.keeper.send({ input, wrong }, () => ({ [key]: input.checked })));
    this.fields.set(`:${shown}`, { input, key: `:${shown}`, wrong });
    return make(
      "div",
      { class: "field" },
      make("span", {}, input, make("label", { for: `set-${key}` }, label)),
      wrong,
      make("p", { class: "help", id: `set-${key}-help` }, help),
    );
  }

  // Shows the run's settings, but leaves alone what is being typed or is wrong, and hides what is asked for elsewhere.
  show(asked = []) {
    for (const key of CALIBRATION) {
      const { host } = this.fields.get(key) ?? {};
      if (host) host.hidden = asked.includes(key);
    }
    const run = this.keeper.now(),
      busy = ["queued", "running", "preparing"].includes(run.state);
    const fill = (input, put) => {
      input.disabled = busy;
      if (document.activeElement !== input && !input.hasAttribute("aria-invalid")) put();
    };
    for (const { key, input, type, choices, set, default: standard } of this.fields.values()) {
      if (key.startsWith(":")) {
        fill(input, () => {
          input.checked = Boolean(run[key.slice(1)]);
        });
        continue;
      }
      const value = at(run.settings ?? {}, key);
      fill(input, () => {
        if (type === "boolean") input.checked = value ?? standard ?? false;
        else input.value = choices?.length ? (value ?? standard) : written(value);
      });
      set.textContent = value === null ? "" : "set by you";
    }
    if (this.patternInput)
      fill(this.patternInput, () => {
        this.patternInput.value = run.pattern ?? "";
      });
  }
}
