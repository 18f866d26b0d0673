// Blind review: movies without their names, in shuffled order; each is accepted, rejected, or left open.

import { get, ofRun, pageOf, post } from "./api.js";
import { ringPath } from "./outline.js";
import { rings } from "./masks.js";
import { Chart, State, byId, draw, make, nearest, withError } from "./shared.js";
import { Viewer } from "./viewer.js";
import { MEANING, does, drafts, say, trouble } from "./page.js";

const { run } = byId("main").dataset,
  host = byId("review");
let judging = null;

function begin() {
  const name = make("input", { type: "text", id: "reviewer", autocomplete: "name", value: drafts.get("person") ?? "" });
  const go = make("button", { type: "submit", class: "main" }, "Begin");
  const form = make(
    "form",
    { class: "raised text" },
    make(
      "p",
      {},
      "You see one movie after the other without its name, group or well, in an order of " +
        "its own. Say whether its numbers are to be trusted; what you decide is kept with the movie. " +
        "You can stop and go on at any time.",
    ),
    make("div", { class: "field" }, make("label", { for: "reviewer" }, "Your name, or initials"), name),
    make("p", { class: "choices" }, go),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!name.value.trim()) {
      name.setAttribute("aria-invalid", "true");
      name.focus();
      say("Your name is needed, so that the decisions can be told apart.");
      return;
    }
    drafts.set("person", name.value.trim());
    does(go, () => next(name.value.trim()));
  });
  host.replaceChildren(form);
}

async function next(reviewer) {
  const { token, n, of } = await post(`${ofRun(run)}/review/next`, { reviewer });
  judging = null;
  if (!token) {
    host.replaceChildren(
      make(
        "p",
        { class: "reason" },
        of ? `All ${of} movies are reviewed. Thank you.` : "There is no measured movie to review yet.",
      ),
      make("p", {}, make("a", { class: "button main", href: pageOf(run) }, "Back to the run")),
    );
    return;
  }
  host.replaceChildren(make("p", { class: "note" }, "Reading …"));
  const base = `/api/review/${encodeURIComponent(token)}`,
    [movie, data] = await Promise.all([get(base), get(`${base}/traces`)]);
  show(reviewer, base, movie, data, n, of);
}

function show(reviewer, base, movie, data, n, of) {
  const state = new State({ frame: 0 }),
    left = make("div"),
    right = make("div", { class: "wide" });
  const why = make("input", { type: "text", id: "why", autocomplete: "off" });
  const send = (accept) => async () => {
    await post(base, { accept, why: why.value.trim() });
    say(accept === null ? "Left open." : accept ? "Accepted." : "Rejected.");
    await next(reviewer);
    byId("main").focus();
  };
  const buttons = [
    ["Accept", true, "A"],
    ["Reject", false, "R"],
    ["Not sure", null, "U"],
  ].map(([text, accept, key]) => {
    const pressed = make("button", { type: "button", "aria-keyshortcuts": key }, `${text} (${key})`);
    pressed.addEventListener("click", () => does(pressed, send(accept)));
    return [key, pressed];
  });
  judging = Object.fromEntries(buttons);
  host.replaceChildren(
    make("p", { class: "note" }, `Movie ${n} of ${of}, reviewed by ${reviewer}`),
    make("progress", { max: of, value: n - 1, "aria-label": "Reviewed" }),
    make("div", { class: "beside even" }, left, right),
  );
  const viewer = new Viewer(left, {
    base,
    info: movie.info,
    label: "Movie to review. Space plays, arrow keys step.",
    state,
  });
  viewer.over.append(
    draw(
      "g",
      { class: "masks", "aria-hidden": "true" },
      ...[...movie.outlines.tissue, ...(movie.outlines.holes ?? [])].map((ring) =>
        draw("path", { class: "tissue", d: ringPath([ring]) }),
      ),
      ...movie.outlines.pillars.map((polygon) => draw("path", { class: "pillar", d: ringPath(rings(polygon)) })),
    ),
  );
  const { time } = data,
    step = time.length > 1 ? (time.at(-1) - time[0]) / (time.length - 1) : 1,
    range = new State({ low: null, high: null });
  const at = (frame) => time[Math.max(0, Math.min(time.length - 1, frame))];
  const charts = data.signals.slice(0, 3).map(
    (signal) =>
      new Chart(right, {
        range,
        id: signal.id,
        height: 130,
        title: signal.title,
        unit: signal.unit,
        lines: signal.lines.map((line, i) => ({ ...line, x: time, colour: i + 1 })),
        step,
        beats: data.beats
          .filter((beat) => !beat.left_out)
          .map((beat) => ({ from: at(beat.start), to: at(beat.stop), peak: at(beat.peak), complete: beat.complete })),
        xLabel: `time, ${data.time_unit}`,
        xUnit: data.time_unit,
        cursor: () => at(state.values.frame),
        pick: (x) => state.set({ frame: nearest(time, x) }),
      }),
  );
  state.listen(() => charts.forEach((chart) => chart.moveCursor()));
  right.append(
    make(
      "dl",
      { class: "facts" },
      ...(movie.numbers ?? []).flatMap((one) => [
        make("dt", {}, one.label),
        make("dd", {}, `${withError(one.value, one.se)} ${one.unit ?? ""}`),
      ]),
    ),
  );
  right.append(make("p", { class: "note" }, MEANING));
  left.append(
    make("h2", {}, "Are these numbers to be trusted?"),
    make("div", { class: "field" }, make("label", { for: "why" }, "Why (may be left empty)"), why),
    make("p", { class: "choices" }, ...buttons.map(([, one]) => one)),
  );
}

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName)) return;
  const pressed = judging?.[event.key.toUpperCase()];
  pressed?.click();
});

get(ofRun(run))
  .then(({ title }) => {
    byId("crumb-run").textContent = title;
  })
  .catch(trouble);
begin();
