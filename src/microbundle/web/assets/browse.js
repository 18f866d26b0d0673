// Browsing the folders the app was started with. Names are untrusted: they are only ever text.

import { get } from "./api.js";
import { draw, make } from "./shared.js";
import { button, bytes, does, moment, say, trouble } from "./page.js";

const KINDS = {
  folder: ["Folder", "M3 6h6l2 2h10v11H3z"],
  movie: ["Movie", "M4 5h16v14H4zM4 9h16M4 15h16M8 5v4M16 5v4M8 15v4M16 15v4"],
  manifest: ["List of movies", "M5 3h14v18H5zM8 8h8M8 12h8M8 16h5"],
  batch: ["Results of a run", "M4 20V4M4 20h16M7 16l4-6 3 3 5-8"],
  result: ["Result of a movie", "M4 20V4M4 20h16M7 16l4-6 3 3 5-8"],
};
const LONG = 12;

export function icon(kind) {
  return draw(
    "svg",
    { class: `icon ${kind}`, viewBox: "0 0 24 24", "aria-hidden": "true" },
    draw("path", { d: KINDS[kind][1] }),
  );
}

export class Browser {
  // `open` is called with the address of what was chosen.
  constructor(host, open) {
    this.open = open;
    this.crumbs = make("ol", { class: "crumbs" });
    this.filter = make("input", {
      type: "search",
      "aria-label": "Show only names with",
      placeholder: "Filter",
      autocomplete: "off",
    });
    this.filter.addEventListener("input", () => this.list());
    this.names = make("ul", { class: "entries", "aria-label": "Folders and movies" });
    this.whole = make("button", { type: "button", class: "main" }, "Open this folder");
    this.whole.addEventListener("click", () => does(this.whole, () => this.open(this.at)));
    this.told = make("p", { class: "note" });
    host.append(
      make("nav", { "aria-label": "Folder" }, this.crumbs),
      this.filter,
      this.names,
      make("p", { class: "choices" }, this.whole, this.told),
    );
  }

  async go(at) {
    const found = await get(`/api/browse?at=${encodeURIComponent(at)}`);
    this.at = found.at;
    this.entries = found.entries;
    this.filter.value = "";
    const steps =
      found.crumbs.length && found.crumbs[0].at === "" ? found.crumbs : [{ name: "Folders", at: "" }, ...found.crumbs];
    this.crumbs.replaceChildren(
      ...steps.map((step, i) =>
        make(
          "li",
          {},
          i === steps.length - 1
            ? make("span", { "aria-current": "location" }, step.name)
            : button(step.name, () => this.walk(step.at), { class: "link" }),
        ),
      ),
    );
    const movies = this.entries.filter((one) => one.kind === "movie").length;
    this.whole.hidden = !found.openable;
    this.told.textContent = found.openable
      ? movies
        ? `${movies === 1 ? "The movie" : `All ${movies} movies`} in it, and those in the folders below.`
        : found.kind === "batch"
          ? "The results of a run, as it was started in a terminal."
          : "All movies in the folders below."
      : "Choose a folder, then a movie or the whole folder.";
    this.list();
    return found;
  }

  async walk(at) {
    const found = await this.go(at);
    (this.names.querySelector("button") ?? this.crumbs.querySelector("button"))?.focus();
    say(`${found.crumbs.at(-1)?.name ?? "Folders"}: ${found.entries.length} entries`);
  }

  list() {
    const asked = this.filter.value.trim().toLowerCase();
    const shown = this.entries.filter((one) => one.name.toLowerCase().includes(asked));
    this.filter.hidden = this.entries.length < LONG;
    this.names.replaceChildren(...shown.map((one) => this.entry(one)));
    if (!shown.length) {
      this.names.append(
        make(
          "li",
          { class: "note empty" },
          this.entries.length ? "No name has this in it." : "There is no movie and no folder here.",
        ),
      );
    }
  }

  entry(one) {
    const into = one.kind === "folder";
    const pressed = make(
      "button",
      { type: "button", class: "entry" },
      icon(one.kind in KINDS ? one.kind : "folder"),
      make("span", { class: "name" }, one.name),
      make(
        "span",
        { class: "more" },
        [
          one.kind === "folder" ? "" : KINDS[one.kind]?.[0],
          into ? "" : bytes(one.bytes),
          into ? "" : moment(one.modified),
        ]
          .filter(Boolean)
          .join(" · "),
      ),
    );
    pressed.addEventListener("click", () => {
      if (into) this.walk(one.at).catch(trouble);
      else does(pressed, () => this.open(one.at));
    });
    return make("li", {}, pressed);
  }
}
