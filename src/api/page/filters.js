// What narrows the list of alerts.

import { check, choice, make, mark } from "./dom.js";
import { changed, state } from "./state.js";
import { TEXTS } from "./texts.js";
import { KINDS, STATUSES } from "./words.js";

/** @type {HTMLSelectElement | null} */
let routes = null;

/** The filters' elements, made once. */
export function filters() {
  const search = make("input");
  Object.assign(search, { type: "search", id: "search", placeholder: TEXTS.search });
  search.setAttribute("aria-label", TEXTS.search);
  search.addEventListener("input", () => { state.filters.text = search.value.trim(); changed(); });
  const set = (/** @type {Partial<typeof state.filters>} */ part) => { Object.assign(state.filters, part); changed(); };
  const decided = [...STATUSES].filter(([status]) => status !== "open" && status !== "acknowledged");
  const view = choice(TEXTS.status, [...Object.entries(TEXTS.views), ...decided], (value) => set({ view: value }));
  routes = choice(TEXTS.route, [["", TEXTS.allRoutes]], (value) => set({ route: value }));
  const kind = choice(TEXTS.kind, [["", TEXTS.allKinds], ...KINDS], (value) => set({ kind: value }));
  const since = choice(TEXTS.when, TEXTS.hours, (value) => set({ hours: Number(value) }));
  const sure = check(TEXTS.confidence, (checked) => set({ sure: checked }));
  const more = make("details", "more", make("summary", "", TEXTS.moreFilters), make("div", "filters", routes, kind, since, sure.label));
  return make("div", "filter", search, view, more);
}

/** Offers the routes that there are. */
export function showRoutesToFilter() {
  if (!routes) return;
  const known = new Set([...routes.options].map((option) => option.value));
  for (const route of state.routes) if (!known.has(route.id)) routes.append(new Option(route.display_name ?? route.id, route.id));
  mark(routes, "data-routes", String(state.routes.length));
}
