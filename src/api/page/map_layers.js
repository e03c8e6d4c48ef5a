// Trajectories, residuals and last poses over the map: reading them into flat arrays, painting what is seen.

import { get, routePath } from "./http.js";
import { Overlay } from "./map_overlay.js";
import { palette, vehicleColour } from "./palette.js";

/**
 * @typedef {import("./map_view.js").Window} Window
 * @typedef {{vehicle: string, xy: Float32Array, bounds: [number, number, number, number]}} Piece
 */

const POINTS_MAX = 20000;
/** As many as show where the vehicles are. */
const POINTS_FOR_POSES = 500;
const EDGES_MAX = 5000;
/** Points of a trajectory that are painted or left out together. */
const PIECE = 128;
const SEGMENTS_A_TURN = 2000;
/** Residuals are compared by their decade. */
const RAMP = ["#5b8db8", "#8f9a4a", "#c9962c", "#d0661f", "#b3261e"];

export const LAYERS = ["trajectories", "residuals", "references", "vehicles"];
/** @type {Set<string>} */
const shown = new Set(["vehicles"]);

/** @type {Piece[]} */
let pieces = [];
/** @type {{vehicle: string, x: number, y: number, towards: number, at: string}[]} */
let last = [];
/** Two ends each, the least residual first. */
let edges = new Float32Array(0);
/** @type {Uint8Array} the colour of each edge */
let decades = new Uint8Array(0);
let references = new Float32Array(0);

export const overlay = new Overlay(paint);
/** @param {string} layer */
export const isShown = (layer) => shown.has(layer);

/**
 * @param {string} layer
 * @param {boolean} on
 */
export function showLayer(layer, on) {
  if (on) shown.add(layer); else shown.delete(layer);
  overlay.drop();
}

/**
 * Reads what the layers that are shown need; what the service does not have stays empty.
 * @param {string} route
 */
export async function readLayers(route) {
  const base = routePath(route) + "/map/layers/";
  const points = shown.has("trajectories") || shown.has("references") ? POINTS_MAX : shown.has("vehicles") ? POINTS_FOR_POSES : 0;
  const [tracks, residuals] = await Promise.all([
    points > 0 ? get(base + "trajectories?max_points=" + points).catch(() => null) : null,
    shown.has("residuals") ? get(base + "residuals?limit=" + EDGES_MAX).catch(() => null) : null,
  ]);
  if (tracks) takeTracks(tracks.items ?? []);
  if (residuals) takeEdges(residuals.items ?? []);
  overlay.drop();
}

export function dropLayers() {
  [pieces, last, edges, references] = [[], [], new Float32Array(0), new Float32Array(0)];
  overlay.drop();
}

/** @param {(import("./types").Track & {references?: number[], last_stamp?: string})[]} tracks the oldest first */
function takeTracks(tracks) {
  pieces = tracks.flatMap(({ vehicle_id, points }) => piecesOf(vehicle_id, points));
  references = Float32Array.from(tracks.flatMap(({ points, references: marks }) => (marks ?? []).flatMap((k) => points[k] ?? [])));
  const newest = new Map();
  for (const { vehicle_id, points } of tracks) {
    const [end, before] = [points.at(-1), points.at(-2)];
    if (end) newest.set(vehicle_id, { vehicle: vehicle_id, x: end[0], y: end[1], towards: before ? Math.atan2(end[1] - before[1], end[0] - before[0]) : 0, at: "" });
  }
  last = [...newest.values()];
}

/**
 * @param {string} vehicle
 * @param {import("./types").Corner[]} points
 * @returns {Piece[]}
 */
function piecesOf(vehicle, points) {
  const made = [];
  for (let from = 0; from < points.length - 1; from += PIECE) {
    const part = points.slice(from, from + PIECE + 1);
    const [xs, ys] = [part.map((corner) => corner[0]), part.map((corner) => corner[1])];
    /** @type {Piece["bounds"]} */
    const bounds = [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
    made.push({ vehicle, xy: Float32Array.from(part.flat()), bounds });
  }
  return made;
}

/** @param {{from: number[], to: number[], residual: number}[]} items */
function takeEdges(items) {
  const sorted = [...items].sort((a, b) => a.residual - b.residual);
  edges = Float32Array.from(sorted.flatMap(({ from, to }) => [...from.slice(0, 2), ...to.slice(0, 2)]));
  const top = Math.log10(Math.max(sorted.at(-1)?.residual ?? 1, 1e-12));
  decades = Uint8Array.from(sorted, ({ residual }) => Math.max(0, RAMP.length - 1 - Math.floor(top - Math.log10(Math.max(residual, 1e-12)))));
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Window} window
 */
function* paint(pen, window) {
  if (shown.has("residuals")) yield* paintEdges(pen, window);
  if (shown.has("trajectories")) yield* paintTracks(pen, window);
  if (shown.has("references")) paintReferences(pen, window);
  if (shown.has("vehicles")) paintVehicles(pen, window);
}

/**
 * What metres of the map lie in a window.
 * @param {Window} window
 */
function seenBy({ x, y, scale, width, height }) {
  const [dx, dy] = [width / 2 / scale, height / 2 / scale];
  return { x0: x - dx, x1: x + dx, y0: y - dy, y1: y + dy };
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Window} window
 */
function* paintTracks(pen, window) {
  const seen = seenBy(window);
  const [ox, oy, scale] = [window.width / 2 - window.x * window.scale, window.height / 2 + window.y * window.scale, window.scale];
  pen.lineWidth = 1.5;
  pen.lineJoin = "round";
  let since = 0;
  for (const { vehicle, xy, bounds } of pieces) {
    if (bounds[0] > seen.x1 || bounds[2] < seen.x0 || bounds[1] > seen.y1 || bounds[3] < seen.y0) continue;
    pen.strokeStyle = vehicleColour(vehicle);
    pen.beginPath();
    for (let k = 0; k < xy.length; k += 2) pen.lineTo(ox + xy[k] * scale, oy - xy[k + 1] * scale);
    pen.stroke();
    since += xy.length / 2;
    if (since > SEGMENTS_A_TURN) { since = 0; yield; }
  }
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Window} window
 */
function* paintEdges(pen, window) {
  const seen = seenBy(window);
  const [ox, oy, scale] = [window.width / 2 - window.x * window.scale, window.height / 2 + window.y * window.scale, window.scale];
  pen.lineWidth = 1;
  let since = 0;
  let decade = -1;
  for (let k = 0; k < decades.length; k += 1) {
    const [x0, y0, x1, y1] = [edges[4 * k], edges[4 * k + 1], edges[4 * k + 2], edges[4 * k + 3]];
    if (Math.max(x0, x1) < seen.x0 || Math.min(x0, x1) > seen.x1 || Math.max(y0, y1) < seen.y0 || Math.min(y0, y1) > seen.y1) continue;
    if (decades[k] !== decade || since > SEGMENTS_A_TURN) {
      if (decade >= 0) pen.stroke();
      if (since > SEGMENTS_A_TURN) { since = 0; yield; }
      decade = decades[k];
      pen.strokeStyle = RAMP[decade];
      pen.beginPath();
    }
    pen.moveTo(ox + x0 * scale, oy - y0 * scale);
    pen.lineTo(ox + x1 * scale, oy - y1 * scale);
    since += 1;
  }
  if (decade >= 0) pen.stroke();
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Window} window
 */
function paintReferences(pen, window) {
  pen.fillStyle = palette().ink;
  for (let k = 0; k < references.length; k += 2) {
    pen.fillRect(window.width / 2 + (references[k] - window.x) * window.scale - 2, window.height / 2 - (references[k + 1] - window.y) * window.scale - 2, 4, 4);
  }
}

/**
 * A triangle at each vehicle's last pose, with its name.
 * @param {CanvasRenderingContext2D} pen
 * @param {Window} window
 */
function paintVehicles(pen, window) {
  pen.font = "12px system-ui, sans-serif";
  pen.textBaseline = "middle";
  for (const { vehicle, x, y, towards } of last) {
    const [px, py] = [window.width / 2 + (x - window.x) * window.scale, window.height / 2 - (y - window.y) * window.scale];
    pen.save();
    pen.translate(px, py);
    pen.rotate(-towards);
    pen.beginPath();
    pen.moveTo(10, 0);
    pen.lineTo(-7, 7);
    pen.lineTo(-7, -7);
    pen.closePath();
    pen.fillStyle = vehicleColour(vehicle);
    pen.fill();
    pen.restore();
    pen.lineWidth = 3;
    pen.strokeStyle = palette().paper;
    pen.strokeText(vehicle, px + 12, py);
    pen.fillStyle = palette().ink;
    pen.fillText(vehicle, px + 12, py);
  }
}
