// The chosen route: its name, its tabs, and the content of the chosen one.

import { routeAddress } from "./address.js";
import { audit } from "./audit.js";
import { batches } from "./batches.js";
import { byId, choice, link, make, mark, say } from "./dom.js";
import { mapElement, readMap, refreshMap } from "./map.js";
import { residuals } from "./residuals.js";
import { settings } from "./settings.js";
import { may, state } from "./state.js";
import { TEXTS } from "./texts.js";
import { vehicles } from "./vehicles.js";
import { versions } from "./versions.js";

/** @type {Record<string, (route: string, again: () => void) => Promise<HTMLElement>>} what a tab shows */
const READ = { vehicles, batches, residuals, versions, settings, audit };

/** @type {ReturnType<typeof build> | null} */
let parts = null;
/** @type {string | null} the route and tab whose content is there */
let shown = null;

function build() {
  const title = make("h2", "unseen", TEXTS.route);
  title.id = "place-title";
  const routes = choice(TEXTS.route, [], (route) => { location.hash = routeAddress(route, state.tab); });
  const summary = make("p", "quiet");
  const tabs = Object.entries(TEXTS.tabs).map(([tab, text]) => Object.assign(link(text, "#/", "tab"), { id: "tab-" + tab }));
  const nav = make("nav", "tabs", ...tabs);
  nav.setAttribute("aria-label", TEXTS.route);
  const content = make("div", "content");
  byId("place").append(title, make("div", "head", routes, summary, nav), content);
  return { routes, summary, tabs, content };
}

/** @param {ReturnType<typeof build>} into */
function offerRoutes({ routes, summary }) {
  const names = state.routes.map((route) => route.id + "\t" + route.display_name).join("\n");
  if (routes.dataset.names !== names) {
    routes.dataset.names = names;
    routes.replaceChildren(...state.routes.map((route) => new Option(route.display_name ?? route.id, route.id)));
  }
  routes.value = state.route ?? "";
  const route = state.routes.find((one) => one.id === state.route);
  say(summary, route ? TEXTS.routeSummary(route) : "");
}

/** Reads the tab's content, and puts it there if it is still the chosen one. */
function read() {
  if (!parts || !state.route) return;
  const key = shown;
  const { content } = parts;
  READ[state.tab](state.route, read).then(
    (made) => { if (shown === key) content.replaceChildren(made); },
    (error) => { if (shown === key) content.replaceChildren(make("p", "refusal", error.message)); },
  );
}

/** Shows the chosen tab of the chosen route. */
export function showRoute() {
  parts ??= build();
  offerRoutes(parts);
  for (const tab of parts.tabs) {
    const name = tab.id.slice("tab-".length);
    mark(tab, "href", routeAddress(state.route ?? "", name));
    tab.hidden = name === "audit" && !may("maintainer");
    mark(tab, "aria-current", name === state.tab ? "page" : null);
  }
  if (!state.route) {
    shown = null;
    parts.content.replaceChildren(make("p", "quiet", state.loaded ? TEXTS.noRoute : TEXTS.connecting));
    return;
  }
  const key = state.route + " " + state.tab;
  if (shown === key) {
    if (state.tab === "map") refreshMap();
    return;
  }
  shown = key;
  if (state.tab === "map") {
    parts.content.replaceChildren(mapElement());
    refreshMap();
    readMap().catch(() => {});
    return;
  }
  parts.content.replaceChildren(make("p", "quiet", TEXTS.connecting));
  read();
}
