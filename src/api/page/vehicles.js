// A route's vehicles: whether they are trusted, why not, how they differ from what they state.

import { ask, toastError } from "./dialog.js";
import { button, make, noteField, table } from "./dom.js";
import { time } from "./format.js";
import { list, routePath, send } from "./http.js";
import { may } from "./state.js";
import { TEXTS } from "./texts.js";

/** @typedef {import("./types").Vehicle} Vehicle */

const SHOWN_MAX = 1000;
const T = TEXTS.vehicles;

/** @param {Vehicle} vehicle */
function known(vehicle) {
  const { faults, changed } = vehicle.calibration;
  const certain = Object.entries(vehicle.calibration).flatMap(([quantity, estimate]) => {
    const isSure = estimate && typeof estimate === "object" && !Array.isArray(estimate) && estimate.sure;
    return isSure ? [make("li", "", T.estimate(T.quantities[quantity] ?? quantity, estimate.value, estimate.sigma, estimate.applied))] : [];
  });
  const texts = [vehicle.reasons, faults, changed].flatMap((some) => (Array.isArray(some) ? some : []));
  return make("ul", "plain", ...texts.map((text) => make("li", "", String(text))), ...certain);
}

/**
 * @param {string} route
 * @param {Vehicle} vehicle
 * @param {() => void} again
 */
function change(route, vehicle, again) {
  if (!may("maintainer")) return null;
  const isTrusted = vehicle.state === "trusted";
  const action = isTrusted ? "quarantine" : "release";
  return button(T.actions[action], async () => {
    const { area, field } = noteField(TEXTS.note, "");
    const isSure = await ask(T.asks[action](vehicle.id), [make("p", "", T.says[action]), field], [[TEXTS.cancel, null], [T.actions[action], true, "main"]]);
    if (!isSure) return;
    const note = area.value.trim();
    const body = isTrusted ? (note ? { note } : {}) : undefined;
    send("POST", routePath(route) + "/vehicles/" + encodeURIComponent(vehicle.id) + "/" + action, body).then(again, toastError);
  });
}

/**
 * @param {string} route
 * @param {() => void} again
 */
export async function vehicles(route, again) {
  /** @type {Vehicle[]} */
  const items = await list(routePath(route) + "/vehicles", SHOWN_MAX);
  if (items.length === 0) return make("p", "quiet", TEXTS.nothing);
  const rows = items.map((vehicle) => [
    vehicle.id, make("span", "state-" + vehicle.state, T.states[vehicle.state] ?? vehicle.state), String(vehicle.counts.trips), String(vehicle.counts.scans),
    vehicle.last_seen ? time(vehicle.last_seen) : null, known(vehicle), change(route, vehicle, again),
  ]);
  return table(TEXTS.tabs.vehicles, T.head, rows);
}
