// The first page: open something, or go on with a run.

import { Browser } from "./browse.js";
import { get, follow, pageOf, post } from "./api.js";
import { startDrop } from "./drop.js";
import { byId } from "./shared.js";
import { connection, onClick, trouble } from "./page.js";
import { showRuns } from "./runs.js";

const open = async (at) => {
  const { run } = await post("/api/open", { at });
  location.assign(pageOf(run));
};

const browser = new Browser(byId("browse"), open);
startDrop(byId("drop"), open);
onClick(byId("example"), async () => {
  byId("example-note").textContent = "The example is being rendered …";
  try {
    const { run } = await post("/api/example");
    location.assign(pageOf(run));
  } catch (error) {
    byId("example-note").textContent = "";
    throw error;
  }
});
follow("/api/events", "runs", ({ runs }) => showRuns(byId("runs"), runs), connection);

try {
  const [app, { runs }] = await Promise.all([get("/api/app"), get("/api/runs")]);
  showRuns(byId("runs"), runs);
  byId("first").hidden = !app.example || runs.length > 0;
  const { entries } = await browser.go("");
  const own = entries.filter((one) => !["uploads", "example"].includes(one.at));
  if (own.length === 1) await browser.go(own[0].at);
} catch (error) {
  trouble(error);
}
