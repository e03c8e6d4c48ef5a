// What an alert rests on: place, times, vehicles; the numbers; its history.

import { facts, link, make } from "./dom.js";
import { placeAddress } from "./address.js";
import { inLocalTime, metres, middle, point, size, time } from "./format.js";
import { TEXTS } from "./texts.js";
import { KINDS, REASONS, STATUSES } from "./words.js";

/** @typedef {import("./types").Alert} Alert */

const F = TEXTS.fields;
const NODES_MAX = 40;

/**
 * What the alert says in one sentence.
 * @param {Alert} alert
 */
export function sentence(alert) {
  if (alert.summary) return inLocalTime(alert.summary, [alert.since, alert.until]);
  return (KINDS.get(alert.kind) ?? alert.kind) + ", " + point(alert.location) + ", " + TEXTS.passes(alert.laps) + ", " + alert.vehicle_ids.join(", ") + ".";
}

/** @param {Alert} alert */
export function placeFacts(alert) {
  const { location, counterpart } = alert;
  const faults = (alert.suspect?.faults ?? []).map((fault) => make("p", "", fault.text));
  const list = facts([
    [F.where, link(point(location) + " ± " + metres(location.sigma), placeAddress(alert.route_id, { ...location, z: 9 }))],
    [F.size, alert.size ? size(alert.size) : null],
    [F.since, time(alert.since)],
    [F.last, time(alert.last_seen)],
    [F.vehicles, alert.vehicle_ids.join(", ")],
    [F.before, alert.passes ? TEXTS.passCounts(alert.passes.before) : null],
    [F.passes, alert.passes ? TEXTS.passCounts(alert.passes.since) : String(alert.laps)],
    [F.sure, (100 * alert.confidence).toFixed(1) + " %"],
    [F.other, counterpart ? (KINDS.get(counterpart.kind) ?? counterpart.kind) + ", " + point(middle(counterpart.region)) : null],
    [F.shift, alert.shift ? point(alert.shift) : null],
    [F.bands, alert.bands.map(({ from, to }) => metres(from) + " – " + metres(to)).join(", ")],
    [F.muted, alert.muted_until ? time(alert.muted_until) : null],
  ]);
  return make("div", "", ...faults, list);
}

/** @param {number | null | undefined} value */
const number = (value) => (value === null || value === undefined ? null : value.toPrecision(3));

/** @param {Alert} alert */
export function numberFacts(alert) {
  const { residual } = alert;
  const nodes = alert.node_ids.slice(0, NODES_MAX).join(", ") + (alert.node_ids.length > NODES_MAX ? " …" : "");
  return facts([
    [F.deltaF, number(residual?.delta_f)],
    [F.threshold, number(residual?.threshold)],
    [F.p, number(residual?.p_value)],
    [F.edges, alert.edge_ids.join(", ")],
    [F.nodes, nodes],
    [F.views, String(alert.views)],
    [F.version, String(alert.map_version)],
    [F.revision, alert.decision_revision + " / " + alert.revision],
    [F.id, alert.id],
  ]);
}

/** @param {Alert} alert */
export function history(alert) {
  const items = alert.history.map((entry) => {
    const reason = entry.reason ? make("p", "", REASONS.get(entry.reason) ?? entry.reason) : null;
    const note = entry.note ? make("p", "note", entry.note) : null;
    return make("li", "", make("strong", "", STATUSES.get(entry.status) ?? entry.status), " ", entry.by, " · ", time(entry.at), reason, note);
  });
  return make("ol", "history", ...items);
}
