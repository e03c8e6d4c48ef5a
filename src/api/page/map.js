// The map of the chosen route on a canvas, with the places of its alerts.

import { button, byId, make, say } from "/dom.js";
import { routePath } from "/http.js";
import { changed, isPending, shownAlerts, state } from "/state.js";
import { TEXTS } from "/texts.js";

const SCALES_M = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500];
const ZOOM_STEP = 1.3;
const REFRESH_MS = 30000;
let parts = null;
/** Metres to pixels, and what lies at the canvas's middle. */
const view = { scale: 20, x: 0, y: 0, fitted: null };
let picture = { key: null, tag: null, image: null, place: null };
let layer = "accepted";
let frame = 0;

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

async function mapPlace(path) {
  const response = await fetch(path);
  if (!response.ok) return null;
  const text = await response.text();
  const resolution = /^resolution:\s*(\S+)/m.exec(text);
  const origin = /^origin:\s*\[\s*([^,\s]+)\s*,\s*([^,\s]+)/m.exec(text);
  return resolution && origin ? { resolution: Number(resolution[1]), x: Number(origin[1]), y: Number(origin[2]) } : null;
}

/** Reads the picture if it has changed. */
export async function readMap() {
  const route = state.route;
  if (!parts || !route || document.hidden) return;
  const key = route + " " + layer;
  const query = "?layer=" + layer;
  const headers = picture.key === key && picture.tag ? { "If-None-Match": picture.tag } : {};
  const response = await fetch(routePath(route) + "/map.png" + query, { headers, cache: "no-store" });
  if (response.status === 304 || key !== state.route + " " + layer) return;
  if (!response.ok) {
    picture = { key, tag: null, image: null, place: null };
  } else {
    const image = await createImageBitmap(await response.blob());
    picture = { key, tag: response.headers.get("ETag"), image, place: await mapPlace(routePath(route) + "/map.yaml" + query) };
  }
  say(parts.empty, picture.image ? "" : TEXTS.noMap);
  if (view.fitted !== route) fit();
  draw();
}

function fit() {
  const { image, place } = picture;
  if (!image || !place) return;
  view.fitted = state.route;
  const [width, height] = [image.width * place.resolution, image.height * place.resolution];
  view.scale = Math.min(parts.canvas.clientWidth / width, parts.canvas.clientHeight / height) || 20;
  view.x = place.x + width / 2;
  view.y = place.y + height / 2;
  draw();
}

/** Moves to a place, metres, near enough to see it. */
export function showPlace({ x, y }) {
  Object.assign(view, { x, y, scale: Math.max(view.scale, 40), fitted: state.route });
  draw();
}

const toScreen = ([x, y]) => [parts.canvas.clientWidth / 2 + (x - view.x) * view.scale, parts.canvas.clientHeight / 2 - (y - view.y) * view.scale];
const toMap = (px, py) => ({ x: view.x + (px - parts.canvas.clientWidth / 2) / view.scale, y: view.y - (py - parts.canvas.clientHeight / 2) / view.scale });

export function draw() {
  if (!frame && parts) frame = requestAnimationFrame(paint);
}

function paint() {
  frame = 0;
  const { canvas } = parts;
  const ratio = devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.fillStyle = colour("--unknown");
  pen.fillRect(0, 0, width, height);
  const { image, place } = picture;
  if (image && place) {
    const size = view.scale * place.resolution;
    const [left, bottom] = toScreen([place.x, place.y]);
    pen.imageSmoothingEnabled = size < 1;
    pen.drawImage(image, left, bottom - image.height * size, image.width * size, image.height * size);
  }
  paintAlerts(pen);
  paintScale(pen, width, height);
}

function paintAlerts(pen) {
  shownAlerts().forEach((alert, k) => {
    if (alert.route_id !== state.route || alert.region.length < 3) return;
    const chosen = alert.id === state.chosen;
    const ink = colour(alert.kind === "appeared" ? "--appeared" : alert.kind === "disappeared" ? "--gone" : "--doubt");
    pen.beginPath();
    for (const corner of alert.region) pen.lineTo(...toScreen(corner));
    pen.closePath();
    pen.globalAlpha = isPending(alert) ? 0.25 : 0.1;
    pen.fillStyle = ink;
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = ink;
    pen.lineWidth = chosen ? 4 : 2;
    pen.setLineDash(alert.tier === "tentative" ? [5, 4] : []);
    pen.stroke();
    pen.setLineDash([]);
    paintNumber(pen, toScreen([alert.location.x, alert.location.y]), String(k + 1), ink, chosen);
  });
}

function paintNumber(pen, [x, y], number, ink, chosen) {
  pen.font = "600 12px system-ui, sans-serif";
  const half = Math.max(10, pen.measureText(number).width / 2 + 6);
  pen.beginPath();
  pen.roundRect(x - half, y - 28, 2 * half, 20, 10);
  pen.fillStyle = ink;
  pen.fill();
  pen.strokeStyle = chosen ? colour("--ink") : "#fff";
  pen.lineWidth = chosen ? 3 : 1;
  pen.stroke();
  pen.fillStyle = "#fff";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(number, x, y - 18);
}

function paintScale(pen, width, height) {
  const length = SCALES_M.findLast((metres) => metres * view.scale <= width / 4) ?? SCALES_M[0];
  const pixels = length * view.scale;
  pen.fillStyle = "rgb(255 255 255 / 80%)";
  pen.fillRect(8, height - 34, pixels + 16, 26);
  pen.fillStyle = pen.strokeStyle = "#1c2430";
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(16, height - 18);
  pen.lineTo(16, height - 13);
  pen.lineTo(16 + pixels, height - 13);
  pen.lineTo(16 + pixels, height - 18);
  pen.stroke();
  pen.font = "11px system-ui, sans-serif";
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
  pen.fillText(length + " m", 20, height - 19);
}

function zoom(factor, px = parts.canvas.clientWidth / 2, py = parts.canvas.clientHeight / 2) {
  const before = toMap(px, py);
  view.scale = Math.min(800, Math.max(0.2, view.scale * factor));
  const after = toMap(px, py);
  view.x += before.x - after.x;
  view.y += before.y - after.y;
  draw();
}

/** The number of pixels between two pointers, and what lies in the middle of them. */
function spread(pointers) {
  const [a, b] = [...pointers.values()];
  return { size: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
}

function hear(canvas, open) {
  const pointers = new Map();
  let moved = 0;
  const at = (event) => ({ x: event.offsetX, y: event.offsetY });
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); pointers.set(event.pointerId, at(event)); moved = 0; });
  canvas.addEventListener("pointermove", (event) => {
    const { x, y } = toMap(event.offsetX, event.offsetY);
    say(parts.pointer, "x " + x.toFixed(2) + "  y " + y.toFixed(2));
    if (!pointers.has(event.pointerId)) return;
    const before = new Map(pointers);
    pointers.set(event.pointerId, at(event));
    const [from, to] = [before.get(event.pointerId), pointers.get(event.pointerId)];
    moved += Math.hypot(to.x - from.x, to.y - from.y);
    if (pointers.size === 2) {
      const [was, is] = [spread(before), spread(pointers)];
      zoom(is.size / Math.max(was.size, 1), is.x, is.y);
    } else {
      view.x -= (to.x - from.x) / view.scale;
      view.y += (to.y - from.y) / view.scale;
      draw();
    }
  });
  const end = (event) => {
    if (pointers.delete(event.pointerId) && moved < 5 && event.type === "pointerup") openAt(toMap(event.offsetX, event.offsetY), open);
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY); }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = 60 / view.scale;
    const keys = { ArrowLeft: () => { view.x -= step; }, ArrowRight: () => { view.x += step; }, ArrowUp: () => { view.y += step; }, ArrowDown: () => { view.y -= step; }, "+": () => zoom(ZOOM_STEP), "-": () => zoom(1 / ZOOM_STEP), 0: fit };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
    draw();
  });
}

/** Opens the alert whose place was clicked, or whose number hangs near it. */
function openAt(place, open) {
  const reach = 24 / view.scale;
  const near = shownAlerts().filter((alert) => alert.route_id === state.route)
    .map((alert) => ({ id: alert.id, away: Math.hypot(alert.location.x - place.x, alert.location.y + 9 / view.scale - place.y) }))
    .filter(({ away }) => away < Math.max(reach, 0.5)).sort((a, b) => a.away - b.away);
  if (near.length > 0) open(near[0].id);
}

/** The map's element, made once. */
export function mapElement(open) {
  if (parts) return parts.element;
  const canvas = make("canvas");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  const layers = make("select");
  layers.setAttribute("aria-label", TEXTS.tabs.map);
  for (const [value, text] of Object.entries(TEXTS.layers)) layers.append(new Option(text, value));
  layers.addEventListener("change", () => { layer = layers.value; readMap().catch(() => {}); changed(); });
  const [pointer, empty] = [make("span", "pointer"), make("p", "quiet empty")];
  const named = (text, label, onClick) => { const made = button(text, onClick); made.setAttribute("aria-label", label); return made; };
  const tools = make("div", "tools", layers, named("+", TEXTS.zoomIn, () => zoom(ZOOM_STEP)), named("−", TEXTS.zoomOut, () => zoom(1 / ZOOM_STEP)), button(TEXTS.fit, fit));
  parts = { canvas, pointer, empty, element: make("div", "map", canvas, tools, pointer, empty) };
  hear(canvas, open);
  new ResizeObserver(() => { if (view.fitted !== state.route) fit(); draw(); }).observe(canvas);
  setInterval(() => readMap().catch(() => {}), REFRESH_MS);
  return parts.element;
}

/** Says whose map it is. */
export const nameMap = (route) => parts?.canvas.setAttribute("aria-label", TEXTS.mapLabel(route));
