// The list of alerts over all routes, and what narrows it.

import { arrange, button, byId, make, say } from "/dom.js";
import { decideSeveral, isPossible } from "/decide.js";
import { age } from "/format.js";
import { changed, shownAlerts, state } from "/state.js";
import { TEXTS } from "/texts.js";
import { ACTIONS, DOUBTS, KINDS, STATUSES } from "/words.js";

const SHOWN_MAX = 300;
const cards = new Map();
let parts = null;

function choice(label, options, onChange) {
  const select = make("select");
  select.setAttribute("aria-label", label);
  for (const [value, text] of options) select.append(new Option(text, value));
  select.addEventListener("change", () => { onChange(select.value); changed(); });
  return select;
}

function build() {
  const search = make("input");
  Object.assign(search, { type: "search", id: "search", placeholder: TEXTS.search });
  search.setAttribute("aria-label", TEXTS.search);
  search.addEventListener("input", () => { state.filters.text = search.value; changed(); });
  const view = choice(TEXTS.inbox, Object.entries(TEXTS.views), (value) => { state.filters.view = value; });
  const route = choice(TEXTS.place, [["", TEXTS.allRoutes]], (value) => { state.filters.route = value; });
  const kind = choice(TEXTS.allKinds, [["", TEXTS.allKinds], ...KINDS], (value) => { state.filters.kind = value; });
  const sure = make("input");
  sure.type = "checkbox";
  sure.addEventListener("change", () => { state.filters.sure = sure.checked; changed(); });
  const title = make("h2", "", TEXTS.inbox);
  title.id = "inbox-title";
  const count = make("p", "quiet");
  const several = make("div", "several");
  several.hidden = true;
  const list = make("ol", "cards");
  const empty = make("p", "quiet");
  byId("inbox").append(make("div", "head", title, count), make("div", "filters", search, view, route, kind, make("label", "check", sure, TEXTS.confidence)), several, list, empty);
  return { route, count, several, list, empty };
}

function card(alert, open) {
  const pick = make("input");
  pick.type = "checkbox";
  pick.addEventListener("change", () => {
    if (pick.checked) state.picked.add(alert.id); else state.picked.delete(alert.id);
    changed();
  });
  const made = { pick, number: make("span", "number"), title: make("strong"), meta: make("span", "quiet"), badges: make("span", "badges"), item: make("li", "card") };
  const link = make("a", "", made.number, make("span", "words", made.title, made.meta, made.badges));
  link.href = "#/alerts/" + alert.id;
  made.link = link;
  made.item.append(make("label", "pick", pick), link);
  return made;
}

function bring(made, alert, number) {
  const title = alert.title ?? KINDS.get(alert.kind) ?? alert.kind;
  say(made.number, String(number));
  say(made.title, title);
  say(made.meta, [alert.route_id, age(alert.since), alert.laps + " ×", alert.vehicle_ids.join(", ")].join(" · "));
  say(made.badges, [STATUSES.get(alert.status), DOUBTS.get(alert.tier), TEXTS.blocking[alert.blocking]].filter(Boolean).join(" · "));
  made.item.className = "card kind-" + alert.kind + " " + alert.status + " " + alert.tier;
  made.pick.setAttribute("aria-label", TEXTS.choose(title + " " + number));
  made.pick.checked = state.picked.has(alert.id);
  if (alert.id === state.chosen) made.link.setAttribute("aria-current", "true"); else made.link.removeAttribute("aria-current");
}

function bringSeveral() {
  const picked = [...state.picked].map((id) => state.alerts.get(id)).filter(Boolean);
  parts.several.hidden = picked.length === 0;
  if (picked.length === 0) return;
  const actions = ["acknowledge", "dismiss"].filter((action) => picked.some((alert) => isPossible(alert, action)));
  parts.several.replaceChildren(make("span", "", TEXTS.chosen(picked.length)), ...actions.map((action) => button(ACTIONS.get(action), () => decideSeveral(action))),
    button(TEXTS.clear, () => { state.picked.clear(); changed(); }));
}

/** Brings the list up to date; cards that stay are changed in place. */
export function showInbox(open) {
  parts ??= build();
  const shown = shownAlerts();
  const known = [...parts.route.options].map((option) => option.value);
  for (const route of state.routes) if (!known.includes(route.id)) parts.route.append(new Option(route.display_name ?? route.id, route.id));
  say(parts.count, TEXTS.count(shown.length, state.alerts.size));
  const items = shown.slice(0, SHOWN_MAX).map((alert, k) => {
    if (!cards.has(alert.id)) cards.set(alert.id, card(alert, open));
    const made = cards.get(alert.id);
    bring(made, alert, k + 1);
    return made.item;
  });
  arrange(parts.list, items);
  parts.empty.hidden = shown.length > 0;
  const { text, kind, route, sure } = state.filters;
  say(parts.empty, text || kind || route || sure ? TEXTS.noMatch : TEXTS.noAlerts);
  bringSeveral();
}
