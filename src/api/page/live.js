// Alerts as they happen. The browser comes back by itself, with the last event that it has seen.

import { alertPath, get, getIfThere, list } from "./http.js";
import { changed, keep, state } from "./state.js";

const RETRY_MS = 3000;
const PENDING_MAX = 2000;
const DECIDED_MAX = 200;
/** @type {EventSource | null} */
let source = null;
/** Ids that were asked for and are not there. */
const unknown = new Set();

/** @param {boolean} live */
function setLive(live) {
  if (state.live === live) return;
  state.live = live;
  changed();
}

/** All that wait for a decision, and the newest of the others. */
async function readAll() {
  const lists = [list("/v1/alerts?status=open", PENDING_MAX), list("/v1/alerts?status=acknowledged", PENDING_MAX), list("/v1/alerts", DECIDED_MAX)];
  for (const alerts of await Promise.all(lists)) for (const alert of alerts) keep(alert);
  state.loaded = true;
  setLive(true);
  changed();
}

/** Follows the stream; what was before it is read once it is open, so that nothing falls in between. */
export function follow() {
  source?.close();
  const opened = new EventSource("/v1/alerts/stream");
  source = opened;
  opened.addEventListener("open", () => readAll().catch(() => setLive(false)));
  for (const kind of ["alert.raised", "alert.updated"]) opened.addEventListener(kind, (event) => keep(JSON.parse(event.data)));
  opened.addEventListener("error", () => {
    setLive(false);
    if (opened.readyState !== EventSource.CLOSED || source !== opened) return;
    // A closed source does not come back by itself, and does not say why: another request finds out.
    get("/v1/routes?limit=1").catch(() => {});
    setTimeout(() => { if (source === opened) follow(); }, RETRY_MS);
  });
}

export function unfollow() {
  source?.close();
  source = null;
}

/**
 * Reads an alert that an address names and the lists did not have.
 * @param {string} id
 */
export async function readAlert(id) {
  if (state.alerts.has(id) || unknown.has(id)) return;
  unknown.add(id);
  const alert = await getIfThere(alertPath(id)).catch(() => null);
  if (alert) keep(alert);
  changed();
}
