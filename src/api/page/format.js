// Times, lengths and counts as people read them.

import { TEXTS } from "/texts.js";

const ZONE = Intl.DateTimeFormat().resolvedOptions().timeZone;
const CLOCK = new Intl.DateTimeFormat("en-GB", { day: "2-digit", month: "short", hour: "2-digit", minute: "2-digit", hour12: false });

/** A time in the local zone; hovering shows the zone and the exact UTC. */
export function time(stamp) {
  const made = document.createElement("time");
  made.dateTime = stamp;
  made.textContent = CLOCK.format(new Date(stamp));
  made.title = ZONE + "; UTC " + stamp;
  return made;
}

/** How long ago, in the largest unit that fits. */
export function age(stamp, now = Date.now()) {
  const minutes = (now - new Date(stamp).getTime()) / 60000;
  const [days, hours, short] = TEXTS.units;
  if (minutes < 1) return TEXTS.justNow;
  if (minutes < 60) return TEXTS.ago(Math.floor(minutes), short);
  return minutes < 1440 ? TEXTS.ago(Math.floor(minutes / 60), hours) : TEXTS.ago(Math.floor(minutes / 1440), days);
}

export const metres = (value) => value.toFixed(2) + " m";
export const point = ({ x, y }) => "x " + metres(x) + ", y " + metres(y);

/** The middle of a polygon's corners. */
export function middle(region) {
  const sum = (k) => region.reduce((total, corner) => total + corner[k], 0) / Math.max(region.length, 1);
  return { x: sum(0), y: sum(1) };
}
