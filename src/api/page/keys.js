// Single keys for what is done most.

import { decide } from "./decide.js";
import { ask } from "./dialog.js";
import { byId, facts } from "./dom.js";
import { alertAddress } from "./address.js";
import { typedNote } from "./panel.js";
import { chosenAlert, state, changed } from "./state.js";
import { shownAlerts } from "./shown.js";
import { TEXTS } from "./texts.js";

/** @param {number} by */
function step(by) {
  const shown = shownAlerts();
  const place = shown.findIndex((alert) => alert.id === state.chosen);
  const next = shown[Math.min(Math.max(place + by, 0), shown.length - 1)];
  if (!next) return;
  // The address is followed a little later: a key that is pressed at once goes on from here.
  state.chosen = next.id;
  location.hash = alertAddress(next.id);
  document.querySelector('.card a[href="' + alertAddress(next.id) + '"]')?.scrollIntoView({ block: "nearest" });
}

/** @param {string} action */
function act(action) {
  const alert = chosenAlert();
  if (alert) decide(alert, action, typedNote());
}

function pick() {
  if (!state.chosen) return;
  if (!state.picked.delete(state.chosen)) state.picked.add(state.chosen);
  changed();
}

export const showHelp = () => ask(TEXTS.help, [facts(TEXTS.helpRows)], [[TEXTS.close, null]]);

/** @type {Record<string, () => unknown>} */
const KEYS = {
  j: () => step(1),
  k: () => step(-1),
  a: () => act("accept"),
  d: () => act("dismiss"),
  e: () => act("acknowledge"),
  u: () => act(chosenAlert()?.actions.includes("undo") ? "undo" : "reopen"),
  x: pick,
  "/": () => byId("search").focus(),
  "?": showHelp,
};

/** @param {KeyboardEvent} event */
function hear(event) {
  const { target } = event;
  const field = target instanceof Element ? target.closest("input:not([type=checkbox]), textarea, select, dialog") : null;
  if (event.key === "Escape" && field instanceof HTMLElement && !field.closest("dialog")) field.blur();
  if (field || document.querySelector("dialog[open]") || event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
}

export const hearKeys = () => document.addEventListener("keydown", hear);
