// Times, lengths and counts as people read them.

import { TEXTS } from "./texts.js";

const ZONE = Intl.DateTimeFormat().resolvedOptions().timeZone;
const CLOCK = new Intl.DateTimeFormat("en-GB", { day: "2-digit", month: "short", hour: "2-digit", minute: "2-digit", hour12: false });

/** @param {string} stamp */
export const clock = (stamp) => CLOCK.format(new Date(stamp));

/**
 * A time in the local zone; hovering shows the zone and the exact UTC.
 * @param {string} stamp
 */
export function time(stamp) {
  const made = document.createElement("time");
  made.dateTime = stamp;
  made.textContent = clock(stamp);
  made.title = ZONE + "; UTC " + stamp;
  return made;
}

/**
 * How long ago, in the largest unit that fits.
 * @param {string} stamp
 */
export function age(stamp, now = Date.now()) {
  const minutes = (now - new Date(stamp).getTime()) / 60000;
  const [days, hours, short] = TEXTS.units;
  if (minutes < 1) return TEXTS.justNow;
  if (minutes < 60) return TEXTS.ago(Math.floor(minutes), short);
  return minutes < 1440 ? TEXTS.ago(Math.floor(minutes / 60), hours) : TEXTS.ago(Math.floor(minutes / 1440), days);
}

/**
 * A sentence of the service, which has UTC, with these times as the rest of the page has them.
 * @param {string} text
 * @param {(string | null)[]} stamps
 */
export function inLocalTime(text, stamps) {
  let said = text;
  for (const stamp of stamps) {
    if (!stamp) continue;
    const [day, minute] = [stamp.slice(0, 10), stamp.slice(11, 16)];
    said = said.replace(new RegExp("\\b(since|from|to) (" + day + " )?" + minute), (_, word) => word + " " + clock(stamp));
  }
  return said;
}

/** @param {number} value */
export const metres = (value) => value.toFixed(2) + " m";
/** @param {{x: number, y: number}} place */
export const point = ({ x, y }) => "x " + metres(x) + ", y " + metres(y);
/** @param {{length: number, width: number}} size */
export const size = ({ length, width }) => length.toFixed(1) + " × " + width.toFixed(1) + " m";

/**
 * The mean of a polygon's corners.
 * @param {import("./types").Corner[]} region
 */
export function middle(region) {
  const sum = (/** @type {0 | 1} */ k) => region.reduce((total, corner) => total + corner[k], 0) / Math.max(region.length, 1);
  return { x: sum(0), y: sum(1) };
}

/**
 * The least box round a polygon, with a margin, counter-clockwise.
 * @param {import("./types").Corner[]} region
 * @param {number} margin_m
 * @returns {import("./types").Corner[]}
 */
export function boxAround(region, margin_m) {
  const [xs, ys] = [region.map((corner) => corner[0]), region.map((corner) => corner[1])];
  const [left, right] = [Math.min(...xs) - margin_m, Math.max(...xs) + margin_m];
  const [low, high] = [Math.min(...ys) - margin_m, Math.max(...ys) + margin_m];
  return [[left, low], [right, low], [right, high], [left, high]];
}
