// Deciding about several alerts at once.

import { carriesOut, isPossible, tagOf } from "./decide.js";
import { progress, toast, toastError } from "./dialog.js";
import { askBeforeAcceptingSeveral, askBeforeDismissing } from "./questions.js";
import { button, make, mark } from "./dom.js";
import { get, send } from "./http.js";
import { shownAlerts } from "./shown.js";
import { typedName } from "./sign_in.js";
import { changed, keep, state, waits } from "./state.js";
import { TEXTS } from "./texts.js";
import { ACTIONS } from "./words.js";

/** @typedef {import("./types").Alert} Alert */

const SEVERAL_MAX = 200;
const POLL_MS = 1000;
const OFFERED = ["acknowledge", "dismiss", "accept"];

const pickedAlerts = () => [...state.picked].flatMap((id) => state.alerts.get(id) ?? []);

/**
 * Shows what can be done with those that are picked.
 * @param {HTMLElement} bar
 */
export function showSeveral(bar) {
  const picked = pickedAlerts();
  const actions = OFFERED.filter((action) => picked.some((alert) => isPossible(alert, action)));
  const key = picked.length + " " + actions.join();
  if (bar.dataset.key === key) return;
  mark(bar, "data-key", key);
  bar.hidden = picked.length === 0;
  const all = button(TEXTS.chooseAll, () => { for (const alert of shownAlerts().slice(0, SEVERAL_MAX)) if (waits(alert)) state.picked.add(alert.id); changed(); });
  const clear = button(TEXTS.clear, () => { state.picked.clear(); changed(); });
  bar.replaceChildren(make("span", "", TEXTS.chosen(picked.length)), ...actions.map((action) => button(ACTIONS.get(action) ?? action, () => decideSeveral(action))), all, clear);
}

/**
 * The same action for all that are picked and allow it.
 * @param {string} action
 */
async function decideSeveral(action) {
  const alerts = pickedAlerts().filter((alert) => isPossible(alert, action)).slice(0, SEVERAL_MAX);
  if (alerts.length === 0) return;
  const said = action === "dismiss" ? await askBeforeDismissing("", null) : action === "accept" ? await askBeforeAcceptingSeveral(alerts.length) : {};
  if (said === null) return;
  const why = { ...(said.note && { note: said.note }), ...(said.reason && { reason: said.reason }) };
  const decisions = alerts.map((alert) => ({ id: alert.id, action, if_match: tagOf(alert), ...why }));
  const waiting = carriesOut(action) ? progress(TEXTS.working) : null;
  try {
    const answer = await send("POST", "/v1/alerts/decisions", { decisions, ...(typedName() && { by: typedName() }) });
    const items = answer.items ?? (await outcome(answer.id, (share) => waiting?.set(share)));
    for (const item of items) {
      if (item.alert) keep(item.alert);
      if (item.result === "done" || item.result === "already_done") state.picked.delete(item.id);
    }
    const failed = items.filter((/** @type {{problem: unknown}} */ item) => item.problem).length;
    toast(TEXTS.several(items.length - failed, failed));
    changed();
  } catch (error) {
    toastError(error);
  } finally {
    waiting?.end();
  }
}

/**
 * Waits for an operation, and returns what became of its decisions.
 * @param {string} id
 * @param {(share: number) => void} onProgress
 * @returns {Promise<any[]>}
 */
async function outcome(id, onProgress) {
  for (;;) {
    /** @type {import("./types").Operation} */
    const operation = await get("/v1/operations/" + encodeURIComponent(id));
    onProgress(operation.progress);
    if (operation.ended_at) {
      if (!operation.result) throw new Error(operation.reason ?? TEXTS.failed);
      return operation.result.items ?? operation.result.decisions ?? [];
    }
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
  }
}
