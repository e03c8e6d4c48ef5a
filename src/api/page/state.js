// What the page knows: alerts, routes, what is chosen. Whoever shows some of it listens.

/**
 * @typedef {import("./types").Alert} Alert
 * @typedef {"vehicle" | "viewer" | "maintainer" | "admin"} Role
 */

const ROLES = ["vehicle", "viewer", "maintainer", "admin"];
const DRAFTS = "drafts";

export const state = {
  /** @type {Map<string, Alert>} */
  alerts: new Map(),
  /** @type {import("./types").Route[]} */
  routes: [],
  /** @type {import("./types").Session} */
  session: { open: true, role: "admin", name: null },
  /** whether the event stream is open, so that what is shown is how it is */
  live: false,
  /** whether all alerts were read once */
  loaded: false,
  /** @type {string | null} the id of the alert in the panel */
  chosen: null,
  /** @type {string | null} */
  route: null,
  tab: "map",
  filters: { view: "pending", route: "", kind: "", hours: 0, sure: false, text: "" },
  /** @type {Set<string>} ids */
  picked: new Set(),
};

/** @type {Set<() => void>} */
const listeners = new Set();
let due = false;

/**
 * Calls `listener` after each change.
 * @param {() => void} listener
 */
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

/**
 * Keeps an alert unless a newer state of it is known.
 * @param {Alert} alert
 */
export function keep(alert) {
  const known = state.alerts.get(alert.id);
  if (known && known.revision > alert.revision) return;
  state.alerts.set(alert.id, alert);
  changed();
}

export const chosenAlert = () => (state.chosen === null ? undefined : state.alerts.get(state.chosen));

/** @param {Alert} alert */
export const isMuted = (alert) => alert.muted === true;
/** @param {Alert} alert */
export const isPending = (alert) => alert.status === "open" || alert.status === "acknowledged";
/** @param {Alert} alert */
export const waits = (alert) => isPending(alert) && !isMuted(alert);

/**
 * Whether this person may do what needs the role.
 * @param {Role} role
 */
export const may = (role) => ROLES.indexOf(state.session.role ?? "") >= ROLES.indexOf(role);

/** @type {Record<string, string>} half-typed notes by the id of their alert */
const drafts = JSON.parse(sessionStorage.getItem(DRAFTS) ?? "{}");

/** @param {string} key */
export const draft = (key) => drafts[key] ?? "";

/**
 * @param {string} key
 * @param {string} text
 */
export function keepDraft(key, text) {
  if (text) drafts[key] = text; else delete drafts[key];
  sessionStorage.setItem(DRAFTS, JSON.stringify(drafts));
}
