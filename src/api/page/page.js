import { offer, showAlerts, showRegions } from "/alerts.js";
import { MEASUREMENTS } from "/words.js";

const REFRESH_MS = 2000;
const SVG = "http://www.w3.org/2000/svg";
const byId = (id) => document.getElementById(id);
let chosen = decodeURIComponent(location.hash.slice(1)) || null;
let shownMap = { tag: null, url: null, route: null, place: null };

async function read(path) {
  const response = await fetch(path, { headers: { Accept: "application/json" } });
  const body = await response.json();
  if (!response.ok) throw new Error(body.detail || response.statusText);
  return body;
}

async function readAll(path) {
  const items = [];
  let cursor = null;
  do {
    const page = await read(path + "?limit=1000" + (cursor ? "&cursor=" + cursor : ""));
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor);
  return items;
}

function cell(row, content, className) {
  const td = row.insertCell();
  if (content instanceof Node) td.append(content);
  else td.textContent = content === null ? "–" : String(content);
  if (className) td.className = className;
}

function routePath(route) {
  return "/v1/routes/" + encodeURIComponent(route);
}

function showRoutes(routes) {
  const rows = routes.map((route) => {
    const row = document.createElement("tr");
    row.setAttribute("aria-selected", String(route.id === chosen));
    const button = document.createElement("button");
    button.className = "link";
    button.textContent = route.display_name ? route.display_name + " (" + route.id + ")" : route.id;
    button.addEventListener("click", () => choose(route.id));
    cell(row, button);
    const counts = route.counts;
    for (const value of [route.stage, "version " + route.map_version, counts.batches, route.pending_batches,
      counts.scans, counts.nodes, counts.loop_closures, counts.vehicles, counts.open_alerts]) cell(row, value);
    return row;
  });
  byId("routes").replaceChildren(...rows);
  byId("no-routes").hidden = routes.length > 0;
}

function showBatches(page) {
  const rows = page.items.slice().reverse().map((batch) => {
    const row = document.createElement("tr");
    for (const value of [batch.id, batch.vehicle_id, batch.trip_id, batch.sequence]) cell(row, value);
    cell(row, batch.status, "status-" + batch.status);
    for (const value of [batch.scans, batch.nodes_added, batch.loop_closures]) cell(row, value);
    cell(row, new Date(batch.received_at).toLocaleString());
    cell(row, [...batch.flags, batch.reason].filter(Boolean).join("; "));
    return row;
  });
  byId("batches").replaceChildren(...rows);
  byId("more-batches").hidden = page.next_cursor === null;
}

async function showMap(route) {
  const same = shownMap.route === route;
  const headers = same && shownMap.tag ? { "If-None-Match": shownMap.tag } : {};
  const response = await fetch(routePath(route) + "/map.png", { headers, cache: "no-store" });
  if (response.status === 304 || route !== chosen) return;
  const image = byId("map");
  if (shownMap.url) URL.revokeObjectURL(shownMap.url);
  shownMap = { tag: null, url: null, route, place: null };
  image.hidden = !response.ok;
  byId("map-note").textContent = response.ok
    ? "Free white, occupied black, unknown grey; 5 cm a pixel." : "No map yet: nothing has been merged.";
  if (response.ok) {
    const tag = response.headers.get("ETag");
    shownMap = { tag, url: URL.createObjectURL(await response.blob()), route, place: await mapPlace(route) };
    image.src = shownMap.url;
    await image.decode();
  }
}

// Where the picture lies in the map frame: metres a pixel, and its lower left corner.
async function mapPlace(route) {
  const response = await fetch(routePath(route) + "/map.yaml");
  if (!response.ok) return null;
  const text = await response.text();
  const resolution = /^resolution:\s*(\S+)/m.exec(text);
  const origin = /^origin:\s*\[\s*([^,\s]+)\s*,\s*([^,\s]+)/m.exec(text);
  if (!resolution || !origin) return null;
  return { resolution: Number(resolution[1]), x: Number(origin[1]), y: Number(origin[2]) };
}

function draw(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

function showCurve(series) {
  const svg = byId("curve");
  svg.replaceChildren();
  const entries = series.entries;
  byId("curve-note").textContent = entries.length === 0 ? "No loop closures yet."
    : entries.length + " loop closures, each with its residual; the line is their mean f(n)"
      + (series.threshold === null ? "; f has not settled yet." : "; dashed the paper's threshold " + series.threshold.toPrecision(3) + ".");
  if (entries.length === 0) return;
  const [left, right, top, bottom] = [50, 590, 10, 270];
  const most = Math.max(1e-12, series.threshold || 0, ...entries.map((e) => Math.max(e.delta_f, e.mean)));
  const x = (n) => left + (right - left) * (n - 0.5) / entries.length;
  const y = (value) => bottom - (bottom - top) * Math.max(0, value) / most;
  for (const entry of entries) {
    const bar = draw(svg, "line", { class: "bar " + entry.verdict, x1: x(entry.n), x2: x(entry.n), y1: bottom, y2: y(entry.delta_f) });
    draw(bar, "title", {}, "n " + entry.n + ", edge " + entry.edge_id + ", ΔF " + entry.delta_f.toPrecision(3));
  }
  draw(svg, "polyline", { class: "mean", points: entries.map((e) => x(e.n).toFixed(1) + "," + y(e.mean).toFixed(1)).join(" ") });
  if (series.threshold !== null) {
    draw(svg, "line", { class: "threshold", x1: left, x2: right, y1: y(series.threshold), y2: y(series.threshold) });
  }
  for (const share of [0, 0.5, 1]) {
    draw(svg, "text", { x: left - 6, y: y(share * most) + 4, "text-anchor": "end" }, (share * most).toPrecision(2));
  }
  draw(svg, "text", { x: left, y: 290 }, "n = 1");
  draw(svg, "text", { x: right, y: 290, "text-anchor": "end" }, "n = " + entries.length);
}

function choose(route) {
  chosen = route;
  location.hash = encodeURIComponent(route);
  refresh();
}

let latest = 0;
async function refresh() {
  const turn = ++latest;
  try {
    const routes = await readAll("/v1/routes");
    if (chosen === null && routes.length > 0) chosen = routes[0].id;
    if (!routes.some((route) => route.id === chosen)) chosen = routes.length > 0 ? routes[0].id : null;
    showRoutes(routes);
    byId("route").hidden = chosen === null;
    if (chosen !== null) {
      byId("route-title").textContent = "Route " + chosen;
      const route = chosen;
      const measurement = byId("measurement").value;
      const status = byId("alert-status").value;
      const [batches, series, alerts] = await Promise.all([
        read(routePath(route) + "/batches?limit=1000"),
        read(routePath(route) + "/residuals?measurement=" + measurement),
        read("/v1/alerts?limit=100&route_id=" + encodeURIComponent(route) + (status ? "&status=" + status : "")),
        showMap(route),
      ]);
      if (route !== chosen || turn !== latest) return;
      showBatches(batches);
      showCurve(series);
      showAlerts(alerts, refresh);
      showRegions(alerts.items, byId("map"), shownMap.place);
    }
    byId("state").textContent = "Read at " + new Date().toLocaleTimeString();
  } catch (error) {
    byId("state").textContent = "The service does not answer: " + error.message;
  }
}

async function keepFresh() {
  if (!document.hidden) await refresh();
  setTimeout(keepFresh, REFRESH_MS);
}

offer(byId("measurement"), MEASUREMENTS);
byId("measurement").addEventListener("change", refresh);
byId("alert-status").addEventListener("change", refresh);
window.addEventListener("hashchange", () => {
  const route = decodeURIComponent(location.hash.slice(1));
  if (route && route !== chosen) choose(route);
});
keepFresh();
