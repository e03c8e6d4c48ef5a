// The shift report: what was raised, decided, by whom, and what is open. Prints on one page.

import { alertAddress } from "./address.js";
import { button, byId, choice, link, make, table } from "./dom.js";
import { clock, point, time } from "./format.js";
import { get } from "./http.js";
import { state } from "./state.js";
import { TEXTS } from "./texts.js";
import { ACTIONS, KINDS, REASONS, STATUSES } from "./words.js";

const HOUR_MS = 3600000;
const T = TEXTS.report;
/** @type {string | null} the address of the report that is shown */
let shown = null;

/** @param {URLSearchParams} query */
function period(query) {
  const until = query.get("until") ?? new Date().toISOString();
  const since = query.get("since") ?? new Date(Date.parse(until) - Number(query.get("hours") ?? 8) * HOUR_MS).toISOString();
  return { since, until, route: query.get("route") ?? "" };
}

/**
 * A link to an alert, by its title if it is known.
 * @param {string} id
 * @param {string} kind
 */
const named = (id, kind) => link(state.alerts.get(id)?.title ?? KINDS.get(kind) ?? kind, alertAddress(id));

/**
 * @param {import("./types").ReportAlert[]} alerts
 * @param {string} caption
 */
function alertTable(alerts, caption) {
  if (alerts.length === 0) return make("p", "quiet", T.none);
  return table(caption, T.alertHead, alerts.map((alert) => [named(alert.id, alert.kind), alert.route_id, point(alert), TEXTS.blocking[state.alerts.get(alert.id)?.blocking ?? ""],
    [STATUSES.get(alert.status), alert.muted ? TEXTS.muted : null].filter(Boolean).join(", "), alert.assignee, time(alert.raised_at)]));
}

/** @param {import("./types").Report} report */
function decided({ decided: all }) {
  if (all.length === 0) return make("p", "quiet", T.none);
  return table(T.decided, T.decidedHead, all.map((one) => {
    const why = [one.reason ? REASONS.get(one.reason) ?? one.reason : null, one.note].filter(Boolean).join(": ");
    return [named(one.alert, one.kind), one.route_id, ACTIONS.get(one.action) ?? one.action, one.by, why, time(one.at)];
  }));
}

/** @param {import("./types").Report} report */
function content(report) {
  const counted = Object.entries(report.counts).filter(([, count]) => typeof count === "number").map(([what, count]) => make("li", "", make("strong", "", String(count)), " " + (T.counts[what] ?? what)));
  const dismissed = report.dismissals.map((one) => [one.route_id, KINDS.get(one.kind) ?? one.kind, one.reason ? REASONS.get(one.reason) ?? one.reason : null, String(one.count)]);
  return [
    make("p", "quiet", clock(report.since) + " – " + clock(report.until)),
    make("ul", "counts", ...counted),
    make("h3", "", T.open), alertTable(report.open, T.open),
    make("h3", "", T.decided), decided(report),
    make("h3", "", T.raised), alertTable(report.raised, T.raised),
    ...(dismissed.length > 0 ? [make("h3", "", T.dismissals), table(T.dismissals, T.dismissalHead, dismissed)] : []),
    ...(report.truncated ? [make("p", "quiet", T.truncated)] : []),
  ];
}

/** @param {URLSearchParams} query */
export async function showReport(query) {
  const key = query.toString() + state.routes.length;
  if (shown === key) return;
  shown = key;
  const { since, until, route } = period(query);
  const go = (/** @type {string} */ hours, /** @type {string} */ of) => { location.hash = "#/report?hours=" + hours + (of ? "&route=" + encodeURIComponent(of) : ""); };
  const hours = choice(T.period, T.periods, (value) => go(value, route));
  hours.value = query.get("hours") ?? "8";
  const routes = choice(TEXTS.route, [["", TEXTS.allRoutes], ...state.routes.map((one) => /** @type {const} */ ([one.id, one.display_name ?? one.id]))], (value) => go(hours.value, value));
  routes.value = route;
  const title = make("h2", "", T.title);
  const body = make("div", "", make("p", "quiet", TEXTS.connecting));
  byId("report").replaceChildren(make("div", "head", title, make("div", "row screen-only", hours, routes, button(T.again, () => { shown = null; showReport(query); }), button(T.print, () => print()))), body);
  const where = "?since=" + encodeURIComponent(since) + "&until=" + encodeURIComponent(until) + (route ? "&route_id=" + encodeURIComponent(route) : "");
  try {
    body.replaceChildren(...content(await get("/v1/report" + where)));
  } catch (error) {
    body.replaceChildren(make("p", "refusal", error instanceof Error ? error.message : String(error)));
  }
}

/** The next visit reads it anew. */
export const forgetReport = () => { shown = null; };
