// Sending a decision about one alert, going on to the next, and the way back.

import { alertAddress } from "./address.js";
import { progress, toast, toastError } from "./dialog.js";
import { alertPath, get, Refused, send } from "./http.js";
import { nextToDecide } from "./shown.js";
import { askBeforeAccepting, askBeforeDismissing } from "./questions.js";
import { typedName } from "./sign_in.js";
import { keep, keepDraft, may, state } from "./state.js";
import { TEXTS } from "./texts.js";
import { mute } from "./zones.js";

/** @typedef {import("./types").Alert} Alert */

const CHANGED = 412;

/**
 * Whether this person can do this with the alert now.
 * @param {Alert} alert
 * @param {string} action
 */
export const isPossible = (alert, action) => state.live && may("maintainer") && alert.actions.includes(action);

/** @param {number} revision */
const tag = (revision) => '"' + revision + '"';
/** @param {Alert} alert */
export const tagOf = (alert) => tag(alert.decision_revision);

/**
 * Whether it changes the map, which takes a while.
 * @param {string} action
 */
export const carriesOut = (action) => ["accept", "undo"].includes(action);

/** @type {Record<string, string>} what takes an action back */
const WAY_BACK = { accept: "undo", dismiss: "reopen" };

/**
 * @param {Alert} alert
 * @param {string} action
 * @param {import("./questions.js").Said} said
 * @returns {Promise<Alert>}
 */
async function carryOut(alert, action, said) {
  const by = typedName();
  const body = { ...(said.note && { note: said.note }), ...(said.reason && { reason: said.reason }), ...(by && { by }) };
  return send("POST", alertPath(alert.id) + "/" + action, body, { "If-Match": said.revision === undefined ? tagOf(alert) : tag(said.revision) });
}

/**
 * @param {Alert} alert
 * @param {string} action
 * @param {string} note
 * @returns {Promise<import("./questions.js").Said | null>}
 */
async function askFirst(alert, action, note) {
  if (action === "accept") return askBeforeAccepting(alert, note);
  if (action === "dismiss") return askBeforeDismissing(note, alert);
  return { note };
}

/**
 * Asks what has to be asked, decides, and opens the next alert.
 * @param {Alert} alert
 * @param {string} action
 * @param {string} note
 * @returns {Promise<boolean>} whether it was decided
 */
export async function decide(alert, action, note) {
  if (!isPossible(alert, action)) return false;
  const said = await askFirst(alert, action, note);
  if (said === null) return false;
  const next = nextToDecide(alert);
  const waiting = carriesOut(action) ? progress(TEXTS.working) : null;
  try {
    const decided = await carryOut(state.alerts.get(alert.id) ?? alert, action, said);
    keep(decided);
    keepDraft(alert.id, "");
    const back = WAY_BACK[action];
    toast(TEXTS.done[action] ?? action, back ? () => decide(state.alerts.get(alert.id) ?? decided, back, "") : undefined);
    if (said.muteHours) await mute(alert, said.muteHours, said.note);
    // Whoever has gone on by themselves is left there.
    if (back && next && state.chosen === alert.id) location.hash = alertAddress(next.id);
    return true;
  } catch (error) {
    if (error instanceof Refused && error.status === CHANGED) keep(await get(alertPath(alert.id)));
    toastError(error);
    return false;
  } finally {
    waiting?.end();
  }
}
