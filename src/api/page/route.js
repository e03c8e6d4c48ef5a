// The chosen route: its map, vehicles, batches, residuals and versions.

import { byId, button, make, say, table } from "/dom.js";
import { time } from "/format.js";
import { get, list, routePath, send } from "/http.js";
import { toast } from "/decide.js";
import { draw, mapElement, nameMap, readMap } from "/map.js";
import { may, state } from "/state.js";
import { TEXTS } from "/texts.js";

const ROWS_MAX = 200;
const SVG = "http://www.w3.org/2000/svg";
let parts = null;
let shown = null;

function build(choose) {
  const title = make("h2", "unseen", TEXTS.place);
  title.id = "place-title";
  const routes = make("select");
  routes.setAttribute("aria-label", TEXTS.place);
  routes.addEventListener("change", () => choose(routes.value, state.tab));
  const tabs = Object.entries(TEXTS.tabs).map(([tab, text]) => {
    const link = make("a", "tab", text);
    link.dataset.tab = tab;
    return link;
  });
  const nav = make("nav", "tabs", ...tabs);
  nav.setAttribute("aria-label", TEXTS.place);
  const content = make("div", "content");
  byId("place").append(title, make("div", "head", routes, nav), content);
  return { routes, tabs, content };
}

async function vehicles(route) {
  const items = await list(routePath(route) + "/vehicles", 1000);
  const known = (vehicle) => [...(vehicle.reasons ?? []), ...(vehicle.calibration?.faults ?? []), ...(vehicle.calibration?.changed ?? [])].map(String).join("; ");
  return table(TEXTS.tabs.vehicles, TEXTS.vehicles, items.map((v) => [v.id, make("span", "state-" + v.state, v.state), String(v.counts.trips), String(v.counts.scans), v.last_seen ? time(v.last_seen) : null, known(v)]));
}

async function batches(route) {
  const page = await list(routePath(route) + "/batches", 1000);
  const rank = (batch) => (["quarantined", "unanchored"].includes(batch.status) ? 0 : batch.status === "merged" ? 2 : 1);
  const items = page.sort((a, b) => rank(a) - rank(b) || b.received_at.localeCompare(a.received_at)).slice(0, ROWS_MAX);
  const status = (batch) => {
    const made = make("span", "", make("span", "status-" + batch.status, batch.status));
    if (rank(batch) === 0 && may("maintainer")) made.append(" ", button(TEXTS.retry, () => send("POST", routePath(route) + "/batches/" + encodeURIComponent(batch.id) + "/retry").then(() => showRoute.again(), (error) => toast(error.message))));
    return made;
  };
  const rows = items.map((b) => [b.id, b.vehicle_id, status(b), String(b.scans), String(b.loop_closures), time(b.received_at), [b.reason, ...b.flags].filter(Boolean).join("; ")]);
  return make("div", "", table(TEXTS.tabs.batches, TEXTS.batches, rows), page.length > ROWS_MAX ? make("p", "quiet", TEXTS.first(ROWS_MAX)) : null);
}

async function versions(route) {
  const items = (await list(routePath(route) + "/versions", 1000)).reverse();
  const link = (text, href) => { const made = make("a", "", text); made.href = href; return made; };
  const files = (version) => {
    const base = routePath(route) + (version.current ? "" : "/versions/" + version.version);
    return make("span", "files", ...["png", "pgm", "yaml"].map((kind) => link(kind.toUpperCase(), base + "/map." + kind)));
  };
  const cause = (version) => (version.cause ? link(version.cause.action, "#/alerts/" + version.cause.alert_id) : null);
  return table(TEXTS.tabs.versions, TEXTS.versions, items.map((v) => [String(v.version), time(v.created_at), cause(v), v.state ?? (v.current ? TEXTS.current : TEXTS.frozen), files(v)]));
}

function line(parent, name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  parent.append(made);
}

async function residuals(route) {
  const series = await get(routePath(route) + "/residuals?max_points=1000");
  const entries = series.entries;
  if (entries.length === 0) return make("p", "quiet", TEXTS.empty);
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 800 320");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", TEXTS.residualLabel);
  const values = entries.map((entry) => Math.max(entry.delta_f, 1e-9));
  const all = series.threshold ? [...values, series.threshold] : values;
  const [low, high] = [Math.log10(Math.min(...all)), Math.log10(Math.max(...all))];
  const y = (value) => 300 - 290 * (Math.log10(Math.max(value, 1e-9)) - low) / Math.max(high - low, 1e-9);
  const last = entries[entries.length - 1].n;
  entries.forEach((entry, k) => line(svg, "circle", { class: "dot " + entry.verdict, cx: (10 + 780 * entry.n / last).toFixed(1), cy: y(values[k]).toFixed(1), r: 2 }));
  if (series.threshold) line(svg, "line", { class: "threshold", x1: 10, x2: 790, y1: y(series.threshold), y2: y(series.threshold) });
  return make("figure", "", svg, make("figcaption", "quiet", TEXTS.residuals(entries.length, series.threshold)));
}

const READ = { vehicles, batches, residuals, versions };

/** Shows the chosen tab of the chosen route. */
export function showRoute(choose, open) {
  parts ??= build(choose);
  const { routes, tabs, content } = parts;
  const names = state.routes.map((route) => route.id).join("\n");
  if (routes.dataset.names !== names) {
    routes.dataset.names = names;
    routes.replaceChildren(...state.routes.map((route) => new Option(route.display_name ? route.display_name + " (" + route.id + ")" : route.id, route.id)));
  }
  routes.value = state.route ?? "";
  for (const link of tabs) {
    link.href = "#/routes/" + encodeURIComponent(state.route ?? "") + "/" + link.dataset.tab;
    if (link.dataset.tab === state.tab) link.setAttribute("aria-current", "page"); else link.removeAttribute("aria-current");
  }
  const key = state.route + " " + state.tab;
  if (shown === key) { draw(); return; }
  shown = key;
  if (!state.route) { content.replaceChildren(make("p", "quiet", TEXTS.noRoute)); shown = null; return; }
  if (state.tab === "map") {
    content.replaceChildren(mapElement(open));
    nameMap(state.route);
    readMap().catch(() => {});
    return;
  }
  content.replaceChildren(make("p", "quiet", TEXTS.connecting));
  READ[state.tab](state.route).then((made) => { if (shown === key) content.replaceChildren(made); }, (error) => { if (shown === key) content.replaceChildren(make("p", "quiet", error.message)); });
}

/** Reads the tab anew. */
showRoute.again = () => { shown = null; };
