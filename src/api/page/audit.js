// Who changed what on a route.

import { link, make, table } from "./dom.js";
import { time } from "./format.js";
import { get } from "./http.js";
import { TEXTS } from "./texts.js";

const SHOWN_MAX = 200;
const T = TEXTS.audit;

/** @param {string} route */
export async function audit(route) {
  const query = "?route_id=" + encodeURIComponent(route);
  const page = await get("/v1/audit" + query + "&limit=" + SHOWN_MAX);
  const items = /** @type {import("./types").AuditEntry[]} */ (page.items);
  const rows = items.map((entry) => [time(entry.at), entry.actor, entry.action, entry.subject]);
  return make("div", "", make("p", "", link(T.csv, "/v1/audit.csv" + query)), rows.length > 0 ? table(TEXTS.tabs.audit, T.head, rows) : make("p", "quiet", TEXTS.nothing),
    page.next_cursor ? make("p", "quiet", T.more(SHOWN_MAX)) : null);
}
