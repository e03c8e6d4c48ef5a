// The map of the chosen route: its canvas and tools, what is read for it and when, and one frame.

import { alertAddress, placeAddress } from "./address.js";
import { button, check, choice, iconButton, make, mark, say } from "./dom.js";
import { get, list, routePath } from "./http.js";
import { hearMap, ZOOM_STEP } from "./map_input.js";
import { isShown, LAYERS, setLayerSource, showLayer, whenLayersRead } from "./map_layers.js";
import { paintLayers } from "./map_lines.js";
import { alertAt, drawMarks, drawScale } from "./map_marks.js";
import { Overlay } from "./map_overlay.js";
import { drawScan } from "./map_scan.js";
import { drawTiles, dropTiles, readTiles } from "./map_tiles.js";
import { fitTo, moved, moveTo, toMap, view, whenMoved, zoomBy, zoomLevel } from "./map_view.js";
import { dark, palette } from "./palette.js";
import { state } from "./state.js";
import { TEXTS } from "./texts.js";

const REFRESH_MS = 30000;
const VERSIONS_MAX = 1000;
const ADDRESS_MS = 400;
/** An alert's place is shown at least at 2.5 cm a pixel. */
const ALERT_ZOOM = 9;

/** @type {ReturnType<typeof build> | null} */
let parts = null;
/** What the picture shows, as `showPicture` has it. */
let picture = "accepted";
/** @type {string | null} the route that was fitted or moved to */
let placed = null;
/** @type {string | null} the route whose map is read */
let reading = null;
/** @type {readonly [number, number, number, number] | null} */
let bounds = null;
/** The version that grows. */
let draft = 0;
let frame = 0;
/** @type {ReturnType<typeof setTimeout> | undefined} */
let addressDue;

function fit() {
  if (bounds) fitTo(bounds);
}

/** Reads the map and its layers, if they have changed. */
export async function readMap() {
  const route = state.route;
  if (!parts || !route || document.hidden) return;
  if (reading !== route) {
    reading = route;
    bounds = null;
    picture = "accepted";
    draft = 0;
    dropTiles();
    setLayerSource(null);
  }
  const { map_version } = await get(routePath(route));
  if (map_version !== draft) { draft = map_version; await offerVersions(route); }
  const { query, against } = meaning();
  const info = await readTiles(route, picture, query, against);
  if (reading !== route) return;
  bounds = info?.bounds ?? null;
  setLayerSource(info && { route, tag: info.tag ?? "" });
  say(parts.empty, info ? "" : TEXTS.noMap);
  if (bounds && placed !== route) { placed = route; fit(); }
}

/** Which maps the chosen picture means: a version, or two of them. */
function meaning() {
  if (picture === "observed") return { query: "?layer=observed", against: null };
  const [version, before] = picture === "accepted" ? [String(draft)] : picture.split("-");
  return { query: "?version=" + version, against: before ? "?version=" + before : null };
}

/** @param {string} route */
async function offerVersions(route) {
  const versions = /** @type {import("./types").Version[]} */ (await list(routePath(route) + "/versions", VERSIONS_MAX));
  const newestFirst = versions.sort((a, b) => b.version - a.version);
  const options = newestFirst.flatMap(({ version, current, state: life }) => [
    ...(current ? [] : [[String(version), TEXTS.versionNumber(version, TEXTS.versions.states[life ?? ""] ?? "")]]),
    ...(version > 1 ? [[version + "-" + (version - 1), TEXTS.versionsCompared(version, version - 1)]] : []),
  ]);
  options.unshift(...Object.entries(TEXTS.pictures));
  parts?.pictures.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
  if (parts) parts.pictures.value = picture;
}

/**
 * Shows another map: `accepted`, `observed`, a version's number, or two with what differs, as `3-2`.
 * @param {string} chosen
 */
export function showPicture(chosen) {
  picture = chosen;
  if (parts) parts.pictures.value = chosen;
  readMap().catch(() => {});
}

/**
 * Moves to a place, near enough to see what is there.
 * @param {import("./types").Point} place metres
 * @param {number} [z] zoom of tiles
 */
export function showPlace(place, z) {
  placed = state.route;
  moveTo(place, z ?? Math.max(zoomLevel(), ALERT_ZOOM));
}

const overlay = new Overlay(paintLayers);

/** Draws in the next frame. */
function draw() {
  if (!frame && parts) frame = requestAnimationFrame(paint);
}

function paint() {
  frame = 0;
  if (!parts) return;
  const { canvas, pen } = parts;
  const ratio = devicePixelRatio || 1;
  const [width, height] = [Math.round(view.width * ratio), Math.round(view.height * ratio)];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.fillStyle = palette().unknown;
  pen.fillRect(0, 0, width, height);
  drawTiles(pen, ratio);
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  overlay.draw(pen, ratio);
  drawScan(pen, state.route);
  drawMarks(pen);
  drawScale(pen);
  say(parts.hint, picture.includes("-") ? TEXTS.differenceHint : "");
  keepAddress();
}

/** The address names what is seen, once it rests. */
function keepAddress() {
  if (document.body.dataset.at !== "route" || placed !== state.route || state.tab !== "map") return;
  clearTimeout(addressDue);
  addressDue = setTimeout(() => {
    if (state.route && document.body.dataset.at === "route" && state.tab === "map") history.replaceState(null, "", placeAddress(state.route, { x: view.x, y: view.y, z: zoomLevel() }));
  }, ADDRESS_MS);
}

function layerChoice() {
  const checks = LAYERS.map((layer) => {
    const { box, label } = check(TEXTS.layers[layer], (checked) => showLayer(layer, checked));
    box.checked = isShown(layer);
    return label;
  });
  return make("details", "layers", make("summary", "", TEXTS.layersTitle), ...checks);
}

function build() {
  const canvas = make("canvas");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  const pen = canvas.getContext("2d", { alpha: false });
  if (!pen) throw new Error(TEXTS.noCanvas);
  const pictures = choice(TEXTS.picture, Object.entries(TEXTS.pictures), showPicture);
  const [pointer, hint, empty] = [make("span", "pointer"), make("p", "hint"), make("p", "quiet nothing")];
  const tools = make("div", "tools", pictures, layerChoice(), iconButton("+", TEXTS.zoomIn, () => zoomBy(ZOOM_STEP)), iconButton("−", TEXTS.zoomOut, () => zoomBy(1 / ZOOM_STEP)), button(TEXTS.fit, fit));
  return { canvas, pen, pictures, pointer, hint, empty, element: make("div", "map", canvas, tools, hint, pointer, empty) };
}

/** The map's element, made once. */
export function mapElement() {
  if (parts) return parts.element;
  const made = build();
  parts = made;
  hearMap(made.canvas, {
    onFit: fit,
    onClick: (px, py) => { const alert = alertAt(px, py); if (alert) location.hash = alertAddress(alert.id); },
    onPoint: (px, py) => { const { x, y } = toMap(px, py); say(made.pointer, "x " + x.toFixed(2) + "  y " + y.toFixed(2)); },
  });
  whenMoved(draw);
  whenLayersRead(() => overlay.drop());
  dark.addEventListener("change", () => overlay.drop());
  new ResizeObserver(() => {
    Object.assign(view, { width: Math.max(made.canvas.clientWidth, 1), height: Math.max(made.canvas.clientHeight, 1) });
    if (bounds && placed !== state.route) { placed = state.route; fit(); }
    moved();
  }).observe(made.canvas);
  setInterval(() => readMap().catch(() => {}), REFRESH_MS);
  return made.element;
}

/** Alerts have changed: their marks are drawn anew, and the map says whose it is. */
export function refreshMap() {
  if (!parts) return;
  mark(parts.canvas, "aria-label", TEXTS.mapLabel(state.route ?? ""));
  draw();
}
