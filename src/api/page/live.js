// Alerts as they happen. The browser comes back by itself, with the last event that it has seen.

import { list } from "/http.js";
import { changed, keep, state } from "/state.js";

const RETRY_MS = 3000;
const ALERTS_MAX = 2000;
let source = null;

function setLive(live) {
  if (state.live === live) return;
  state.live = live;
  changed();
}

async function readAll() {
  for (const alert of await list("/v1/alerts", ALERTS_MAX)) keep(alert);
  setLive(true);
}

/** Follows the stream; what was before it is read once it is open, so that nothing falls in between. */
export function follow() {
  source?.close();
  source = new EventSource("/v1/alerts/stream");
  source.addEventListener("open", () => readAll().catch(() => setLive(false)));
  for (const kind of ["alert.raised", "alert.updated"]) source.addEventListener(kind, (event) => keep(JSON.parse(event.data)));
  source.addEventListener("error", () => {
    setLive(false);
    // A closed source does not come back by itself.
    if (source.readyState === EventSource.CLOSED) setTimeout(follow, RETRY_MS);
  });
}

export const unfollow = () => source?.close();
