// Decisions: what is asked before them, sending them, and taking them back.

import { ask, button, byId, make } from "/dom.js";
import { getIfThere, send } from "/http.js";
import { isPending, keep, may, shownAlerts, state } from "/state.js";
import { TEXTS } from "/texts.js";
import { ACTIONS, REASONS } from "/words.js";

const TOAST_MS = 20000;

/** Whether this person can do this with the alert now. */
export const isPossible = (alert, action) => state.live && may("maintainer") && alert.actions.includes(action);

export function toast(text, undo) {
  const made = make("p", "toast", text);
  if (undo) made.append(button(TEXTS.undo, () => { made.remove(); undo(); }));
  byId("toasts").append(made);
  setTimeout(() => made.remove(), TOAST_MS);
}

const by = () => (state.session.open ? byId("by").value.trim() : "");
const tag = (alert) => '"' + alert.decision_revision + '"';

async function carryOut(alert, action, said) {
  const body = { ...(said.note && { note: said.note }), ...(said.reason && { reason: said.reason }), ...(by() && { by: by() }) };
  const decided = await send("POST", "/v1/alerts/" + alert.id + "/" + action, body, { "If-Match": tag(alert) });
  keep(decided);
  return decided;
}

/** The way back from an action; there is none from an acknowledgement that nobody needs. */
const wayBack = (action) => ({ accept: "undo", dismiss: "reopen" })[action];

function noteField(value) {
  const note = make("textarea");
  note.maxLength = 2000;
  note.rows = 2;
  note.value = value;
  return [make("label", "field", TEXTS.note, note), note];
}

async function askBeforeAccepting(alert, note) {
  const preview = await getIfThere("/v1/alerts/" + alert.id + "/preview").catch(() => null);
  const [field, area] = noteField(note);
  const rows = preview ? [make("p", "quiet", JSON.stringify(preview))] : [];
  const answer = await ask(TEXTS.acceptTitle, [make("p", "", alert.summary ?? ""), make("p", "", TEXTS.acceptBody(alert)), ...rows, field],
    [[TEXTS.cancel, null], [ACTIONS.get("accept"), true, "main"]]);
  return answer ? { note: area.value.trim() } : null;
}

async function askBeforeDismissing(note) {
  const set = make("fieldset", "", make("legend", "unseen", TEXTS.dismissTitle));
  REASONS.forEach((label, value) => {
    const radio = make("input");
    Object.assign(radio, { type: "radio", name: "reason", value, checked: value === "temporary" });
    set.append(make("label", "radio", radio, label));
  });
  const [field, area] = noteField(note);
  const answer = await ask(TEXTS.dismissTitle, [make("p", "", TEXTS.dismissBody), set, field], [[TEXTS.cancel, null], [ACTIONS.get("dismiss"), true, "main"]]);
  return answer ? { note: area.value.trim(), reason: set.querySelector("input:checked").value } : null;
}

/** Asks what has to be asked, decides, and opens the next alert. `open` shows an alert. */
export async function decide(alert, action, note, open) {
  if (!isPossible(alert, action)) return false;
  let said = { note };
  if (action === "accept") said = await askBeforeAccepting(alert, note);
  if (action === "dismiss") said = await askBeforeDismissing(note);
  if (said === null) return false;
  const next = nextToDecide(alert);
  try {
    if (action === "accept" || action === "undo") toast(TEXTS.working);
    const decided = await carryOut(state.alerts.get(alert.id), action, said);
    const back = wayBack(action);
    toast(TEXTS.done[action], back && (() => decide(decided, back, "", open)));
    if (back && next) open(next.id);
    return true;
  } catch (error) {
    toast(error.message);
    return false;
  }
}

function nextToDecide(alert) {
  const waiting = shownAlerts().filter((other) => isPending(other) || other.id === alert.id);
  const place = waiting.findIndex((other) => other.id === alert.id);
  return waiting[place + 1] ?? waiting.find((other) => other.id !== alert.id);
}

/** The same action for all that are picked and allow it. */
export async function decideSeveral(action) {
  const alerts = [...state.picked].map((id) => state.alerts.get(id)).filter((alert) => alert && isPossible(alert, action));
  if (alerts.length === 0) return;
  const said = action === "dismiss" ? await askBeforeDismissing("") : {};
  if (said === null) return;
  const decisions = alerts.slice(0, 200).map((alert) => ({ id: alert.id, action, if_match: tag(alert), ...(said.note && { note: said.note }), ...(said.reason && { reason: said.reason }) }));
  try {
    const answer = await send("POST", "/v1/alerts/decisions", { decisions, ...(by() && { by: by() }) });
    for (const item of answer.items) {
      if (item.alert) keep(item.alert);
      if (item.result === "done" || item.result === "already_done") state.picked.delete(item.id);
    }
    const failed = answer.items.filter((item) => item.problem !== null).length;
    toast(TEXTS.several(answer.items.length - failed, failed));
  } catch (error) {
    toast(error.message);
  }
}
