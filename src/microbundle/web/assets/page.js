// What all pages share: words for numbers and states, troubles at the top, and what is told to screen readers.

import { byId, make, showTips } from "./shared.js";

export const STATES = {
  draft: "Not started",
  queued: "Waiting",
  running: "Running",
  done: "Done",
  stopped: "Stopped",
  failed: "Failed",
  todo: "Not yet",
  preparing: "Being made",
};
export const VERDICTS = { pass: "Pass", review: "Review", fail: "Fail" };
const STATE_LOOK = {
  running: "info",
  queued: "info",
  preparing: "info",
  done: "pass",
  stopped: "review",
  failed: "fail",
};

export function badge(element, state) {
  element.textContent = STATES[state] ?? VERDICTS[state] ?? state;
  element.className = `badge ${STATE_LOOK[state] ?? (state in VERDICTS ? state : "")}`;
  return element;
}

export const madeBadge = (state) => badge(make("span"), state);

export function say(text) {
  byId("said").textContent = text;
}

// One trouble at a time stands at the top of the page; `kind` lets its end take it away again.
export function trouble(error, kind = "") {
  const box = byId("trouble"),
    message = typeof error === "string" ? error : error.message;
  if (error.name === "AbortError") return;
  const close = make("button", { type: "button", "aria-label": "Close this message" }, "Close");
  close.addEventListener("click", () => calm());
  box.replaceChildren(make("p", {}, message), close);
  box.dataset.kind = error.kind ?? kind;
  box.hidden = false;
}

export function calm(kind) {
  const box = byId("trouble");
  if (kind === undefined || box.dataset.kind === kind) box.hidden = true;
}

export const connection = (message) =>
  message ? trouble(message, "connection") : (calm("connection"), calm("Unreachable"));

// Runs what a button asks for; the button waits meanwhile, keeping the focus, and what goes wrong is told.
export async function does(button, action) {
  if (button.getAttribute("aria-busy") === "true") return;
  button.setAttribute("aria-busy", "true");
  calm();
  try {
    await action();
  } catch (error) {
    trouble(error);
  } finally {
    button.removeAttribute("aria-busy");
  }
}

export function onClick(button, action) {
  button.addEventListener("click", () => does(button, action));
}

export function button(text, action, attributes = {}) {
  const made = make("button", { type: "button", ...attributes }, text);
  onClick(made, action);
  return made;
}

export const MEANING =
  "Means over whole beats, ± the standard error of the measurement. How much beats vary is in the report.";

// A text with `code` in it, as the settings' texts have.
export const worded = (text) => (text ?? "").split("`").map((part, i) => (i % 2 ? make("code", {}, part) : part));

export const counted = (n, one, many = `${one}s`) => `${n} ${n === 1 ? one : many}`;

export function bytes(n) {
  if (n === null || n === undefined) return "";
  const at = Math.min(4, Math.floor(Math.log10(Math.max(1, n)) / 3));
  return `${at ? (n / 1000 ** at).toPrecision(3) : n} ${["B", "kB", "MB", "GB", "TB"][at]}`;
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "";
  if (seconds < 90) return counted(Math.max(1, Math.round(seconds)), "second");
  if (seconds < 5400) return counted(Math.round(seconds / 60), "minute");
  return `${(seconds / 3600).toFixed(1)} hours`;
}

// Of an ISO text, or of seconds since 1970.
export const moment = (when) =>
  when
    ? new Date(typeof when === "number" ? 1000 * when : when).toLocaleString(undefined, {
        dateStyle: "medium",
        timeStyle: "short",
      })
    : "";

export const soon = (wait, action) => {
  let timer;
  return (...values) => {
    clearTimeout(timer);
    timer = setTimeout(() => action(...values), wait);
  };
};

// What a person has typed or drawn is kept in this browser until it is saved.
export const drafts = {
  get(key) {
    try {
      return JSON.parse(localStorage.getItem(`microbundle ${key}`));
    } catch {
      return null;
    }
  },
  set(key, value) {
    try {
      if (value === null) localStorage.removeItem(`microbundle ${key}`);
      else localStorage.setItem(`microbundle ${key}`, JSON.stringify(value));
    } catch {
      /* no room: the page still works */
    }
  },
};

// Tabs by click and by arrow keys; the address keeps which one is open.
export function startTabs(list, opened) {
  const tabs = [...list.querySelectorAll("[role=tab]")];
  const open = (chosen, focus) => {
    for (const tab of tabs) {
      const is = tab === chosen;
      tab.setAttribute("aria-selected", is);
      tab.tabIndex = is ? 0 : -1;
      byId(tab.getAttribute("aria-controls")).hidden = !is;
    }
    if (focus) chosen.focus();
    const name = chosen.id.replace("tab-", "");
    history.replaceState(null, "", `#${name}`);
    opened(name);
  };
  for (const [i, tab] of tabs.entries()) {
    tab.addEventListener("click", () => open(tab));
    tab.addEventListener("keydown", (event) => {
      const to = { ArrowRight: i + 1, ArrowLeft: i - 1, Home: 0, End: tabs.length - 1 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      open(tabs[(to + tabs.length) % tabs.length], true);
    });
  }
  const asked = () => tabs.find((tab) => tab.id === `tab-${location.hash.slice(1)}`);
  addEventListener("hashchange", () => asked() && open(asked()));
  open(asked() ?? tabs[0]);
}

showTips();
