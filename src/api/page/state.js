// What the page knows: alerts, routes, what is chosen. Whoever shows some of it listens.

export const state = {
  /** @type {Map<string, any>} alerts by id */
  alerts: new Map(),
  routes: [],
  session: { open: true, role: "admin", name: null },
  live: false,
  /** the id of the alert in the panel */
  chosen: null,
  route: null,
  tab: "map",
  filters: { view: "pending", route: "", kind: "", sure: false, text: "" },
  picked: new Set(),
};

const listeners = new Set();
let due = false;

/** Calls `listener` after each change. */
export const listen = (listener) => listeners.add(listener);

/** Tells all listeners, once for changes that come together. */
export function changed() {
  if (due) return;
  due = true;
  queueMicrotask(() => {
    due = false;
    for (const listener of listeners) listener();
  });
}

/** Keeps an alert unless a newer state of it is known. */
export function keep(alert) {
  const known = state.alerts.get(alert.id);
  if (known && known.revision > alert.revision) return;
  state.alerts.set(alert.id, alert);
  changed();
}

export const isPending = (alert) => alert.status === "open" || alert.status === "acknowledged";

function matches(alert) {
  const { view, route, kind, sure, text } = state.filters;
  if (view === "pending" && !isPending(alert) && alert.id !== state.chosen) return false;
  if (route && alert.route_id !== route) return false;
  if (kind && alert.kind !== kind) return false;
  if (sure && alert.confidence < 0.9) return false;
  if (!text) return true;
  const words = [alert.id, alert.route_id, alert.title ?? "", alert.summary ?? "", ...alert.vehicle_ids, ...alert.history.map((entry) => entry.note ?? "")];
  return words.join(" ").toLowerCase().includes(text.toLowerCase());
}

/** The alerts that the filters let through, those to decide first, each kind of them the newest first. */
export function shownAlerts() {
  const shown = [...state.alerts.values()].filter(matches);
  const rank = (alert) => (isPending(alert) ? (alert.tier === "confirmed" ? 0 : 1) : 2);
  return shown.sort((a, b) => rank(a) - rank(b) || b.raised_at.localeCompare(a.raised_at) || b.id.localeCompare(a.id));
}

export const may = (role) => {
  const roles = ["vehicle", "viewer", "maintainer", "admin"];
  return roles.indexOf(state.session.role) >= roles.indexOf(role);
};
