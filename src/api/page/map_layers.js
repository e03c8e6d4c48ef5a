// Trajectories, closures, references and last poses of a route, as flat arrays for painting.

import { get, routePath } from "./http.js";
import { moved } from "./map_view.js";

/**
 * @typedef {import("./types").Corner} Corner
 * @typedef {[number, number, number, number]} Box x0, y0, x1, y1, metres
 * @typedef {{vehicle: string, xy: Float32Array, bounds: Box}} Piece
 * @typedef {{vehicle_id: string, points: Corner[], last_pose: import("./types").Pose | null}} Track
 * @typedef {{from: Corner, to: Corner, residual: number}} Closure
 */

const POINTS = 20000;
/** As few as the service gives: last poses need none. */
const POINTS_FOR_POSES = 100;
const CLOSURES = 5000;
/** Points of a trajectory that are painted or left out together. */
const PIECE = 128;
const LEAST_RESIDUAL = 1e-12;
/** Residuals are compared by their decade: the colour of the least first. */
export const RAMP = ["#5b8db8", "#8f9a4a", "#c9962c", "#d0661f", "#b3261e"];
export const LAYERS = ["trajectories", "residuals", "references", "vehicles"];

/** @type {Set<string>} */
const shown = new Set(["vehicles"]);
/** @param {string} layer */
export const isShown = (layer) => shown.has(layer);

export const found = {
  /** @type {Piece[]} */
  pieces: [],
  /** @type {{vehicle: string, x: number, y: number, towards: number}[]} */
  last: [],
  /** two ends each, the least residual first */
  edges: new Float32Array(0),
  /** the place in `RAMP` of each edge */
  decades: new Uint8Array(0),
  references: new Float32Array(0),
};

/** @type {{route: string, tag: string} | null} whose layers, and which state of the map */
let source = null;
/** @type {Map<string, string>} what was read, and of which source */
const known = new Map();
let onRead = () => {};

/**
 * Calls `listener` when something was read.
 * @param {() => void} listener
 */
export const whenLayersRead = (listener) => { onRead = listener; };

/**
 * @param {string} layer
 * @param {boolean} on
 */
export function showLayer(layer, on) {
  if (on) shown.add(layer); else shown.delete(layer);
  onRead();
  moved();
  readLayers().catch(() => {});
}

/**
 * Says whose layers they are, and when they have changed.
 * @param {typeof source} now
 */
export function setLayerSource(now) {
  if (now?.route !== source?.route) { known.clear(); takeTracks([]); takeClosures([]); takeReferences([]); }
  source = now;
  readLayers().catch(() => {});
}

/** Reads what is shown and has changed. */
async function readLayers() {
  if (!source) return;
  const { route, tag } = source;
  const points = shown.has("trajectories") ? POINTS : shown.has("vehicles") ? POINTS_FOR_POSES : 0;
  await Promise.all([
    points > 0 ? read(route, tag, "trajectories?max_points=" + points, (body) => takeTracks(body.items)) : null,
    shown.has("residuals") ? read(route, tag, "residuals?limit=" + CLOSURES, (body) => takeClosures(body.items)) : null,
    shown.has("references") ? read(route, tag, "keyframes", (body) => takeReferences(body.points)) : null,
  ]);
}

/**
 * @param {string} route
 * @param {string} tag
 * @param {string} path
 * @param {(body: any) => void} take
 */
async function read(route, tag, path, take) {
  const layer = path.split("?")[0];
  const key = path + tag;
  if (known.get(layer) === key) return;
  known.set(layer, key);
  try {
    const body = await get(routePath(route) + "/map/layers/" + path);
    if (source?.route === route && known.get(layer) === key) take(body);
  } catch (error) {
    known.delete(layer);
    throw error;
  }
  onRead();
}

/** @param {Track[]} tracks the newest first */
function takeTracks(tracks) {
  found.pieces = tracks.toReversed().flatMap(piecesOf);
  found.last = tracks.flatMap(({ vehicle_id, last_pose }) => (last_pose ? [{ vehicle: vehicle_id, x: last_pose.x, y: last_pose.y, towards: last_pose.theta }] : []));
}

/** @param {Corner[]} points */
function takeReferences(points) {
  found.references = Float32Array.from(points.flat());
}

/** @param {Closure[]} closures */
function takeClosures(closures) {
  const sorted = [...closures].sort((a, b) => a.residual - b.residual);
  found.edges = Float32Array.from(sorted.flatMap(({ from, to }) => [...from, ...to]));
  const decade = (/** @type {number} */ residual) => Math.log10(Math.max(residual, LEAST_RESIDUAL));
  const top = decade(sorted.at(-1)?.residual ?? 1);
  found.decades = Uint8Array.from(sorted, ({ residual }) => Math.max(0, RAMP.length - 1 - Math.floor(top - decade(residual))));
}

/**
 * A trajectory in pieces that are painted together.
 * @param {Track} track
 * @returns {Piece[]}
 */
function piecesOf({ vehicle_id, points }) {
  /** @type {Piece[]} */
  const pieces = [];
  for (let from = 0; from < points.length - 1; from += PIECE) {
    const part = points.slice(from, from + PIECE + 1);
    const [xs, ys] = [part.map((corner) => corner[0]), part.map((corner) => corner[1])];
    pieces.push({ vehicle: vehicle_id, xy: Float32Array.from(part.flat()), bounds: [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)] });
  }
  return pieces;
}
