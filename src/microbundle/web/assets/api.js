// The server's answers, and what went wrong in words.

export class Refused extends Error {
  constructor(kind, message, status = 0, body = {}) {
    super(message);
    Object.assign(this, { kind, status, body });
  }
}

const SILENT =
  "The program behind this page does not answer. If it was closed, start it again with “microbundle app”; " +
  "this page then goes on by itself. Runs go on meanwhile.";

async function answer(path, { method = "GET", body, signal } = {}) {
  let response;
  try {
    response = await fetch(path, {
      method,
      signal,
      headers: { "X-Microbundle": "1", ...(body === undefined ? {} : { "Content-Type": "application/json" }) },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Refused("Unreachable", SILENT);
  }
  if (response.ok) return response;
  let told = {};
  try {
    told = await response.json();
  } catch {
    /* not one of the server's own errors */
  }
  throw new Refused(
    told.error?.kind ?? "Failed",
    told.error?.message ??
      `The program refused this (${response.status}). Reload the page; the log in the terminal says more.`,
    response.status,
    told,
  );
}

export const get = async (path, options) => (await answer(path, options)).json();
export const picture = async (path, signal) => (await answer(path, { signal })).blob();
export const send = async (method, path, body = {}, options = {}) =>
  (await answer(path, { method, body, ...options })).json();
export const post = (path, body, options) => send("POST", path, body, options);

export const ofRun = (run) => `/api/runs/${encodeURIComponent(run)}`;
export const ofMovie = (run, key) => `${ofRun(run)}/movies/${encodeURIComponent(key)}`;
export const pageOf = (run, key) =>
  `/run/${encodeURIComponent(run)}${key === undefined ? "" : `/${encodeURIComponent(key)}`}`;
export const fileOf = (run, path) => `${ofRun(run)}/files/${path.split("/").map(encodeURIComponent).join("/")}`;

// Hears the server's events until the page goes; `lost` is called with a message, or with null when it is back.
export function follow(path, event, heard, lost) {
  const source = new EventSource(path);
  let last = "";
  source.addEventListener(event, (message) => {
    if (message.data === last) return;
    last = message.data;
    heard(JSON.parse(message.data));
  });
  source.addEventListener("gone", () => {
    source.close(); // or it would ask again, for what is no more
    location.assign("/");
  });
  source.addEventListener("open", () => lost(null));
  source.addEventListener("error", () => lost(SILENT));
  addEventListener("pagehide", () => source.close());
  return () => source.close();
}
