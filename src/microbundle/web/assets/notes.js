// Notes, whether the numbers are accepted, and everything that was decided on this movie, each to be taken back.

import { make } from "./shared.js";
import { button, does, drafts, moment, say } from "./page.js";

const KINDS = {
  drop_beat: (one) => `Beat at frame ${one.peak_frame} left out`,
  mark_beat: (one) => `Beat marked: frames ${one.start_frame} to ${one.stop_frame}, peak ${one.peak_frame}`,
  use_mask: (one) => `Mask of the ${one.name.replace("_", " ")} by hand`,
  settings: (one) => `Settings: ${flat(one.settings).join(", ")}`,
  verdict: (one) => (one.accept ? "Numbers accepted" : "Numbers rejected"),
  note: (one) => `Note: ${one.text}`,
};

const flat = (settings, above = "") =>
  Object.entries(settings).flatMap(([name, value]) =>
    value && typeof value === "object" && !Array.isArray(value)
      ? flat(value, `${above}${name}.`)
      : [`${above}${name} = ${JSON.stringify(value)}`],
  );

export async function startNotes(panel, movie) {
  const draftKey = `note ${movie.run} ${movie.key}`;
  const person = make("input", { type: "text", autocomplete: "name", value: drafts.get("person") ?? "", id: "person" });
  person.addEventListener("change", () => drafts.set("person", person.value.trim() || null));
  const text = make("textarea", { rows: 4, id: "note" });
  text.value = drafts.get(draftKey) ?? "";
  text.addEventListener("input", () => drafts.set(draftKey, text.value || null));
  const keep = button("Keep the note", async () => {
    if (!text.value.trim()) return;
    await movie.save((decisions) => [...decisions, { kind: "note", text: text.value.trim(), ...movie.sign() }]);
    text.value = "";
    drafts.set(draftKey, null);
    say("The note is kept.");
  });
  const why = make("input", { type: "text", id: "why", autocomplete: "off" });
  const judge = (accept) => async () => {
    await movie.save((decisions) => [
      ...decisions.filter((one) => one.kind !== "verdict"),
      { kind: "verdict", accept, ...movie.sign(why.value.trim()) },
    ]);
    why.value = "";
    say(accept ? "Accepted." : "Rejected.");
  };
  const judged = make("p", { role: "status" });
  const accept = button("Accept the numbers", judge(true)),
    reject = button("Reject them", judge(false));
  const list = make("ol", { class: "decisions" }),
    none = make("p", { class: "note" }, "Nothing is decided on this movie yet.");
  panel.replaceChildren(
    make(
      "div",
      { class: "beside even" },
      make(
        "div",
        { class: "side" },
        make(
          "div",
          { class: "field" },
          make("label", { for: "person" }, "Your name, or initials"),
          person,
          make("p", { class: "help" }, "Stands beside what you decide. Kept in this browser."),
        ),
        make("h2", {}, "Are these numbers right?"),
        judged,
        make("div", { class: "field" }, make("label", { for: "why" }, "Why"), why),
        make("p", { class: "choices" }, accept, reject),
        make("h2", {}, "Note"),
        make("div", { class: "field" }, make("label", { for: "note", class: "unseen" }, "Note"), text),
        make("p", { class: "choices" }, keep),
      ),
      make(
        "div",
        {},
        make("h2", {}, "Decided so far"),
        none,
        list,
        make(
          "p",
          { class: "note" },
          "They lie beside the result, in the file ",
          make("code", {}, `results/${movie.key}.decisions.json`),
          ", and are used whenever this movie is measured, here or on the command line.",
        ),
      ),
    ),
  );
  const refresh = () => {
    const last = movie.decisions.findLast((one) => one.kind === "verdict");
    judged.textContent = last ? `${KINDS.verdict(last)}${last.why ? `: ${last.why}` : ""}` : "Nobody has said so yet.";
    none.hidden = movie.decisions.length > 0;
    list.replaceChildren(
      ...movie.decisions.map((one, i) => {
        const same = JSON.stringify(one),
          back = make("button", { type: "button", "aria-label": `Take back: ${KINDS[one.kind](one)}` }, "Take back");
        back.addEventListener("click", () =>
          does(back, async () => {
            await movie.save((decisions) =>
              decisions.filter(
                (other, n) =>
                  !(JSON.stringify(other) === same && (n === i || decisions.length !== movie.decisions.length)),
              ),
            );
            say("Taken back.");
          }),
        );
        const signed = [one.kind === "verdict" ? one.why : "", one.by, moment(one.at)].filter(Boolean).join(" · ");
        return make(
          "li",
          {},
          make("span", {}, KINDS[one.kind](one), ...(signed ? [make("span", { class: "stage-note" }, signed)] : [])),
          back,
        );
      }),
    );
  };
  refresh();
  return { refresh };
}
