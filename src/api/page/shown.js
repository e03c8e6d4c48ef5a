// Which alerts the filters let through, in which order. The card's number is the place in it.

import { isMuted, isPending, state, waits } from "./state.js";

/** @typedef {import("./types").Alert} Alert */

const HOUR_MS = 3600000;
const SURE = 0.9;

/** @type {Record<string, (alert: Alert) => boolean>} */
const VIEWS = {
  pending: waits,
  muted: (alert) => isPending(alert) && isMuted(alert),
  all: () => true,
};

/** @param {Alert} alert */
function words(alert) {
  const notes = alert.history.flatMap((entry) => [entry.by, entry.note ?? ""]);
  return [alert.id, alert.route_id, alert.title ?? "", alert.summary ?? "", alert.assignee ?? "", ...alert.vehicle_ids, ...notes].join(" ").toLowerCase();
}

/** @param {Alert} alert */
function matches(alert) {
  const { view, route, kind, hours, sure, text } = state.filters;
  const isOfView = VIEWS[view]?.(alert) ?? alert.status === view;
  // What has just been decided stays until another one is chosen.
  if (!isOfView && alert.id !== state.chosen) return false;
  if (route && alert.route_id !== route) return false;
  if (kind && alert.kind !== kind) return false;
  if (hours && Date.now() - new Date(alert.last_seen).getTime() > hours * HOUR_MS) return false;
  if (sure && alert.confidence < SURE) return false;
  return !text || words(alert).includes(text.toLowerCase());
}

/** @param {Alert} alert */
function rank(alert) {
  if (!waits(alert)) return 3;
  if (alert.tier !== "confirmed") return 2;
  return alert.blocking === "blocking" ? 0 : 1;
}

/** What stands on the vehicles' way comes first, then what is confirmed, then the rest; the newest first. */
export function shownAlerts() {
  const shown = [...state.alerts.values()].filter(matches);
  return shown.sort((a, b) => rank(a) - rank(b) || b.raised_at.localeCompare(a.raised_at) || b.id.localeCompare(a.id));
}

/**
 * The alert that is decided next after this one.
 * @param {Alert} alert
 */
export function nextToDecide(alert) {
  const waiting = shownAlerts().filter((other) => waits(other) || other.id === alert.id);
  const place = waiting.findIndex((other) => other.id === alert.id);
  return waiting[place + 1] ?? waiting.find((other) => other.id !== alert.id);
}
