// Every setting with its text, the same as the command line's.

import { get } from "./api.js";
import { byId, make } from "./shared.js";
import { trouble, worded } from "./page.js";

try {
  const [app, sections] = await Promise.all([get("/api/app"), get("/api/settings")]);
  byId("workspace").textContent = app.workspace;
  byId("list").replaceChildren(
    ...sections.map(({ title, text, fields }) =>
      make(
        "details",
        {},
        make("summary", {}, title),
        make("p", { class: "note" }, ...worded(text)),
        make(
          "dl",
          { class: "help-list" },
          ...fields.flatMap((one) => [
            make("dt", {}, one.label, " ", make("code", {}, one.key)),
            make(
              "dd",
              {},
              ...worded(one.text),
              ...(one.default === null || one.default === undefined
                ? []
                : [` Default: ${JSON.stringify(one.default)}.`]),
            ),
          ]),
        ),
      ),
    ),
  );
} catch (error) {
  trouble(error);
}
