// Zones where alerts are recorded but not sent: making one, and the list of a route's.

import { toast, toastError } from "./dialog.js";
import { button, make, table } from "./dom.js";
import { boxAround, middle, point, time } from "./format.js";
import { getIfThere, getTagged, routePath, send } from "./http.js";
import { may } from "./state.js";
import { TEXTS } from "./texts.js";
import { KINDS } from "./words.js";

/** @typedef {import("./types").Zone} Zone */

const MARGIN_M = 0.3;
const HOUR_MS = 3600000;

/**
 * Mutes the place of an alert for its kind.
 * @param {import("./types").Alert} alert
 * @param {number} hours
 * @param {string} [note]
 */
export async function mute(alert, hours, note) {
  const until = new Date(Date.now() + hours * HOUR_MS).toISOString();
  const zone = { polygon: boxAround(alert.region, MARGIN_M), purpose: "mute", kinds: [alert.kind], until, ...(note && { note }) };
  try {
    await send("POST", routePath(alert.route_id) + "/zones", zone);
    toast(TEXTS.mutedFor(hours));
  } catch (error) {
    toastError(error);
  }
}

/**
 * @param {string} route
 * @param {Zone} zone
 */
async function remove(route, zone) {
  const path = routePath(route) + "/zones/" + encodeURIComponent(zone.id);
  const { tag } = await getTagged(path);
  await send("DELETE", path, undefined, tag ? { "If-Match": tag } : {});
}

/**
 * The zones of a route, each with a way to end it; null where the service knows none.
 * @param {string} route
 * @param {() => void} again
 */
export async function zoneTable(route, again) {
  const page = await getIfThere(routePath(route) + "/zones");
  if (!page) return null;
  const title = make("h3", "", TEXTS.zones);
  if (page.items.length === 0) return make("section", "", title, make("p", "quiet", TEXTS.noZones));
  const rows = page.items.map((/** @type {Zone} */ zone) => {
    const end = may("maintainer") ? button(TEXTS.endZone, () => { remove(route, zone).then(again, toastError); }) : null;
    const kinds = zone.kinds?.map((kind) => KINDS.get(kind) ?? kind).join(", ") ?? TEXTS.allKinds;
    return [point(middle(zone.polygon)), kinds, zone.until ? time(zone.until) : TEXTS.forGood, zone.created_by, zone.note, end];
  });
  return make("section", "", title, table(TEXTS.zones, TEXTS.zoneHead, rows));
}
