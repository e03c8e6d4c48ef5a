// The chosen alert: a sentence, what was observed, what can be done, and what it rests on.

import { history, numberFacts, placeFacts, sentence } from "./alert_facts.js";
import { decide, isPossible } from "./decide.js";
import { Discussion } from "./discussion.js";
import { arrange, button, byId, link, make, say } from "./dom.js";
import { Evidence } from "./evidence.js";
import { readAlert } from "./live.js";
import { hideScan } from "./map_scan.js";
import { Passes } from "./passes.js";
import { chosenAlert, draft, isMuted, keepDraft, may, state } from "./state.js";
import { TEXTS } from "./texts.js";
import { ACTIONS, DOUBTS, KINDS, STATUSES } from "./words.js";

/** @typedef {import("./types").Alert} Alert */

/** @type {View | null} */
let view = null;

/** @param {Alert} alert */
function chips(alert) {
  const chip = (/** @type {string | null | undefined} */ text, className = "") => (text ? make("li", className, text) : null);
  const all = [
    chip(TEXTS.blocking[alert.blocking ?? ""], alert.blocking ?? ""),
    chip(STATUSES.get(alert.status), alert.status),
    chip(DOUBTS.get(alert.tier)),
    chip(isMuted(alert) ? TEXTS.muted : null),
    chip(alert.route_id),
  ];
  return all.filter((made) => made !== null);
}

class View {
  /** @param {Alert} alert */
  constructor(alert) {
    this.id = alert.id;
    this.revision = -1;
    this.title = make("h2");
    this.title.id = "panel-title";
    this.title.tabIndex = -1;
    this.sentence = make("p", "sentence");
    this.chips = make("ul", "chips");
    this.note = make("textarea");
    Object.assign(this.note, { rows: 1, maxLength: 2000, placeholder: TEXTS.note, value: draft(alert.id) });
    this.note.setAttribute("aria-label", TEXTS.note);
    this.note.addEventListener("input", () => keepDraft(alert.id, this.note.value));
    this.actions = make("div", "row");
    /** @type {Map<string, HTMLButtonElement>} */
    this.buttons = new Map();
    this.evidence = new Evidence(alert.id);
    this.passes = new Passes(alert);
    this.discussion = new Discussion(alert);
    this.place = make("div");
    this.numbers = make("div");
    this.history = make("div");
    const details = make("details", "", make("summary", "", TEXTS.details), this.numbers);
    const body = make("div", "alert", link(TEXTS.back, "#/", "back"), this.title, this.chips, this.sentence, this.evidence.element, this.passes.element, this.place,
      this.discussion.element, make("h3", "", TEXTS.history), this.history, details);
    this.locked = make("p", "quiet");
    byId("panel").replaceChildren(body, make("div", "actions", this.note, this.actions, this.locked));
    byId("panel").scrollTop = 0;
  }

  /**
   * Changes what differs; the note and the focus stay.
   * @param {Alert} alert
   */
  bring(alert) {
    this.bringActions(alert);
    if (this.revision === alert.revision) return;
    this.revision = alert.revision;
    say(this.title, alert.title ?? KINDS.get(alert.kind) ?? alert.kind);
    say(this.sentence, sentence(alert));
    this.chips.replaceChildren(...chips(alert));
    this.place.replaceChildren(placeFacts(alert));
    this.numbers.replaceChildren(numberFacts(alert));
    this.history.replaceChildren(history(alert));
    this.discussion.bring(alert);
    this.evidence.bring().catch(() => {});
    this.passes.bring().catch(() => {});
  }

  /** @param {Alert} alert */
  bringActions(alert) {
    const shown = alert.actions.map((action) => {
      const made = this.buttons.get(action) ?? button(ACTIONS.get(action) ?? action, () => { this.run(action); }, action === "accept" ? "main" : "");
      this.buttons.set(action, made);
      made.disabled = !isPossible(alert, action);
      return made;
    });
    arrange(this.actions, shown);
    say(this.locked, may("maintainer") ? "" : TEXTS.onlyMaintainers);
  }

  /** @param {string} action */
  async run(action) {
    const alert = state.alerts.get(this.id);
    if (alert && (await decide(alert, action, this.note.value.trim()))) this.note.value = "";
  }
}

/** What is half typed about the chosen alert. */
export const typedNote = () => view?.note.value.trim() ?? "";

/**
 * A new alert in the panel; the focus stays there if it was there.
 * @param {Alert} alert
 */
function open(alert) {
  const hadFocus = view !== null && (document.activeElement === document.body || byId("panel").contains(document.activeElement));
  hideScan();
  view?.evidence.stop();
  view = new View(alert);
  if (hadFocus) view.title.focus({ preventScroll: true });
}

/** Shows the chosen alert, or says that none is. */
export function showPanel() {
  const alert = chosenAlert();
  if (alert) {
    if (view?.id !== alert.id) open(alert);
    view?.bring(alert);
    return;
  }
  if (state.chosen && state.loaded) readAlert(state.chosen);
  view = null;
  const text = !state.chosen ? TEXTS.noneChosen : state.loaded ? TEXTS.unknownAlert : TEXTS.connecting;
  if (byId("panel").textContent === TEXTS.panel + text) return;
  const title = make("h2", "unseen", TEXTS.panel);
  title.id = "panel-title";
  byId("panel").replaceChildren(title, make("p", "quiet", text));
}
