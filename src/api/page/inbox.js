// The list of alerts over all routes.

import { alertAddress } from "./address.js";
import { arrange, byId, link, make, mark, say } from "./dom.js";
import { filters, showRoutesToFilter } from "./filters.js";
import { age, size } from "./format.js";
import { showSeveral } from "./several.js";
import { shownAlerts } from "./shown.js";
import { changed, isMuted, state } from "./state.js";
import { TEXTS } from "./texts.js";
import { DOUBTS, KINDS, STATUSES } from "./words.js";

/** @typedef {import("./types").Alert} Alert */

const SHOWN_MAX = 300;
/** @type {Map<string, Card>} */
const cards = new Map();
/** @type {ReturnType<typeof build> | null} */
let parts = null;

function build() {
  const title = make("h2", "", TEXTS.inbox);
  title.id = "inbox-title";
  const [count, several, list, empty] = [make("p", "quiet"), make("div", "several"), make("ol", "cards"), make("p", "quiet empty-list")];
  several.hidden = true;
  byId("inbox").append(make("div", "head", title, count), filters(), several, list, empty);
  return { count, several, list, empty };
}

/** An alert in the list; changed in place, so that it keeps the focus. */
class Card {
  /** @param {string} id */
  constructor(id) {
    this.pick = make("input");
    this.pick.type = "checkbox";
    this.pick.addEventListener("change", () => {
      if (this.pick.checked) state.picked.add(id); else state.picked.delete(id);
      changed();
    });
    this.number = make("span", "number");
    this.title = make("strong");
    this.where = make("span", "quiet");
    this.badges = make("span", "badges");
    this.link = link(this.number, alertAddress(id));
    this.link.append(make("span", "words", this.title, this.where, this.badges));
    this.item = make("li", "card", make("label", "pick", this.pick), this.link);
  }

  /**
   * @param {Alert} alert
   * @param {number} number
   */
  bring(alert, number) {
    const title = alert.title ?? KINDS.get(alert.kind) ?? alert.kind;
    say(this.number, String(number));
    say(this.title, title);
    const measured = alert.size && !alert.title ? size(alert.size) : null;
    say(this.where, [alert.route_id, measured, age(alert.last_seen), TEXTS.passes(alert.laps), alert.vehicle_ids.join(", ")].filter(Boolean).join(" · "));
    const muted = isMuted(alert) ? TEXTS.muted : null;
    const assigned = alert.assignee ? TEXTS.assignedTo(alert.assignee) : null;
    say(this.badges, [STATUSES.get(alert.status), DOUBTS.get(alert.tier), TEXTS.blocking[alert.blocking ?? ""], muted, assigned].filter(Boolean).join(" · "));
    this.item.className = ["card", "kind-" + alert.kind, alert.status, alert.tier, alert.blocking ?? ""].join(" ");
    this.pick.setAttribute("aria-label", TEXTS.choose(number + ", " + title));
    this.pick.checked = state.picked.has(alert.id);
    mark(this.link, "aria-current", alert.id === state.chosen ? "true" : null);
  }
}

/** @param {Alert} alert */
function cardOf(alert) {
  const card = cards.get(alert.id) ?? new Card(alert.id);
  cards.set(alert.id, card);
  return card;
}

/** Brings the list up to date. */
export function showInbox() {
  parts ??= build();
  showRoutesToFilter();
  const shown = shownAlerts();
  say(parts.count, TEXTS.count(shown.length, state.alerts.size));
  const items = shown.slice(0, SHOWN_MAX).map((alert, k) => {
    const card = cardOf(alert);
    card.bring(alert, k + 1);
    return card.item;
  });
  arrange(parts.list, items);
  const { text, kind, route, sure, hours } = state.filters;
  const isNarrowed = Boolean(text || kind || route || sure || hours || state.filters.view !== "pending");
  parts.empty.hidden = shown.length > 0 && shown.length <= SHOWN_MAX;
  say(parts.empty, shown.length > 0 ? TEXTS.onlyFirst(SHOWN_MAX) : !state.loaded ? TEXTS.connecting : isNarrowed ? TEXTS.noMatch : TEXTS.noAlerts);
  showSeveral(parts.several);
}
