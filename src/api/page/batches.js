// A route's batches: first those that need attention, with the reason.

import { toastError } from "./dialog.js";
import { button, make, table } from "./dom.js";
import { time } from "./format.js";
import { get, list, routePath, send } from "./http.js";
import { may } from "./state.js";
import { TEXTS } from "./texts.js";

/** @typedef {import("./types").Batch} Batch */

const EACH_MAX = 200;
const REFUSED = ["quarantined", "unanchored"];
const WAITING = ["held", "queued", "processing"];
const T = TEXTS.batches;

/**
 * @param {string} route
 * @param {Batch} batch
 * @param {() => void} again
 */
function status(route, batch, again) {
  const made = make("span", "", make("span", "status-" + batch.status, T.statuses[batch.status] ?? batch.status));
  if (REFUSED.includes(batch.status) && may("maintainer")) {
    made.append(" ", button(T.retry, () => { send("POST", routePath(route) + "/batches/" + encodeURIComponent(batch.id) + "/retry").then(again, toastError); }));
  }
  return made;
}

/**
 * @param {string} route
 * @param {string} title
 * @param {Batch[]} items
 * @param {() => void} again
 */
function part(route, title, items, again) {
  const rows = items.map((batch) => [batch.id, batch.vehicle_id, status(route, batch, again), String(batch.scans), String(batch.loop_closures), time(batch.received_at), [batch.reason, ...batch.flags].filter(Boolean).join("; ")]);
  return make("section", "", make("h3", "", title), rows.length > 0 ? table(title, T.head, rows) : make("p", "quiet", TEXTS.nothing));
}

/**
 * @param {string} route
 * @param {() => void} again
 */
export async function batches(route, again) {
  const path = routePath(route) + "/batches";
  const of = (/** @type {string[]} */ names) => Promise.all(names.map((name) => list(path + "?status=" + name, EACH_MAX))).then((lists) => lists.flat());
  const [refused, waiting, merged] = await Promise.all([of(REFUSED), of(WAITING), get(path + "?status=merged&limit=" + EACH_MAX)]);
  const newestFirst = (/** @type {Batch} */ a, /** @type {Batch} */ b) => b.received_at.localeCompare(a.received_at);
  return make("div", "", part(route, T.refused, refused.sort(newestFirst), again), part(route, T.waiting, waiting.sort(newestFirst), again),
    part(route, T.merged, merged.items.sort(newestFirst), again), merged.next_cursor ? make("p", "quiet", T.more(EACH_MAX)) : null);
}
