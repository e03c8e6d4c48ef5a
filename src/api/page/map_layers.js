// Trajectories, edges and references of the part of the map that is seen, as flat arrays.

import { get, routePath } from "./http.js";
import { moved, view, whenMoved } from "./map_view.js";

/**
 * @typedef {[number, number, number, number]} Box x0, y0, x1, y1, metres
 * @typedef {{vehicle: string, xy: Float32Array, bounds: Box}} Piece
 * @typedef {{id: number, pose: import("./types").Pose, vehicle_id: string, trip_id: string, stamp: string, reference: boolean}} Node
 * @typedef {{from: number, to: number, kind: string, residual: number}} Edge
 */

/** A larger part of the graph is not read at once: its lines would cover the map anyway. */
const NODES_MAX = 4000;
/** More than the window is read, so that one can move before it is read anew. */
const OVERSIZE = 1.5;
const REST_MS = 400;
/** Points of a trajectory that are painted or left out together. */
const PIECE = 128;
/** Keyframes of a trip that lie farther apart are not joined by a line, metres. */
const GAP_M = 4;
/** Residuals are compared by their decade: the colour of the least first. */
export const RAMP = ["#5b8db8", "#8f9a4a", "#c9962c", "#d0661f", "#b3261e"];
export const LAYERS = ["trajectories", "residuals", "references", "vehicles"];

/** @type {Set<string>} */
const shown = new Set();
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

/** @type {{route: string, tag: string, nodes: number, bounds: Box} | null} whose graph it is */
let source = null;
/** @type {{tag: string, box: Box} | null} what of it was read */
let known = null;
/** @type {ReturnType<typeof setTimeout> | undefined} */
let due;
let onRead = () => {};

/**
 * Reads again whenever another part is seen, and calls `listener` when something was read.
 * @param {() => void} listener
 */
export function keepLayersRead(listener) {
  onRead = listener;
  whenMoved(() => {
    clearTimeout(due);
    if (shown.size > 0) due = setTimeout(() => { read().catch(() => {}); }, REST_MS);
  });
}

/**
 * @param {string} layer
 * @param {boolean} on
 */
export function showLayer(layer, on) {
  if (on) shown.add(layer); else shown.delete(layer);
  onRead();
  moved();
}

/**
 * Says whose layers they are, and when they have changed.
 * @param {typeof source} now
 */
export function setLayerSource(now) {
  if (now?.route !== source?.route) take([], []);
  source = now;
  if (shown.size > 0) read().catch(() => {});
}

/** Whether what is seen is too much to read. */
export const isTooMuch = () => shown.size > 0 && source !== null && share() * source.nodes > NODES_MAX;

/** The part of the map that is read, as a share of its area. */
function share() {
  if (!source) return 0;
  const [x0, y0, x1, y1] = boxToRead(source.bounds);
  const whole = (source.bounds[2] - source.bounds[0]) * (source.bounds[3] - source.bounds[1]);
  return Math.max(x1 - x0, 0) * Math.max(y1 - y0, 0) / Math.max(whole, 1);
}

/**
 * @param {Box} bounds
 * @returns {Box}
 */
function boxToRead(bounds) {
  const [dx, dy] = [OVERSIZE * view.width / view.scale / 2, OVERSIZE * view.height / view.scale / 2];
  return [Math.max(view.x - dx, bounds[0]), Math.max(view.y - dy, bounds[1]), Math.min(view.x + dx, bounds[2]), Math.min(view.y + dy, bounds[3])];
}

/** Whether what was read still holds, and reaches over what is seen. */
function isKnown() {
  if (!known || !source || known.tag !== source.tag) return false;
  const [dx, dy] = [view.width / view.scale / 2, view.height / view.scale / 2];
  const [x0, y0, x1, y1] = source.bounds;
  return known.box[0] <= Math.max(view.x - dx, x0) && known.box[2] >= Math.min(view.x + dx, x1) && known.box[1] <= Math.max(view.y - dy, y0) && known.box[3] >= Math.min(view.y + dy, y1);
}

async function read() {
  if (!source || isKnown() || isTooMuch()) return;
  const [asked, box] = [source, boxToRead(source.bounds)];
  known = { tag: asked.tag, box };
  const graph = await get(routePath(asked.route) + "/graph?bbox=" + box.map((value) => value.toFixed(2)).join(","));
  if (asked.route === source?.route) take(graph.nodes, graph.edges);
}

/**
 * @param {Node[]} nodes
 * @param {Edge[]} edges
 */
function take(nodes, edges) {
  const inTime = [...nodes].sort((a, b) => a.stamp.localeCompare(b.stamp) || a.id - b.id);
  const trips = Map.groupBy(inTime, (node) => node.trip_id);
  found.pieces = [...trips.values()].flatMap(piecesOf);
  found.last = [...new Map(inTime.map((node) => [node.vehicle_id, node])).values()].map(({ vehicle_id, pose }) => ({ vehicle: vehicle_id, x: pose.x, y: pose.y, towards: pose.theta }));
  found.references = Float32Array.from(nodes.filter((node) => node.reference).flatMap(({ pose }) => [pose.x, pose.y]));
  const at = new Map(nodes.map((node) => [node.id, node.pose]));
  const closures = edges.filter((edge) => edge.kind !== "odometry").sort((a, b) => a.residual - b.residual);
  const ends = closures.flatMap((edge) => {
    const [from, to] = [at.get(edge.from), at.get(edge.to)];
    return from && to ? [{ residual: edge.residual, xy: [from.x, from.y, to.x, to.y] }] : [];
  });
  found.edges = Float32Array.from(ends.flatMap(({ xy }) => xy));
  const top = Math.log10(Math.max(ends.at(-1)?.residual ?? 1, 1e-12));
  found.decades = Uint8Array.from(ends, ({ residual }) => Math.max(0, RAMP.length - 1 - Math.floor(top - Math.log10(Math.max(residual, 1e-12)))));
  onRead();
}

/**
 * A trip's nodes in pieces that are painted together; where it leaves the part that was read, one ends.
 * @param {Node[]} nodes
 * @returns {Piece[]}
 */
function piecesOf(nodes) {
  /** @type {import("./types").Pose[][]} */
  const lines = [];
  for (const { pose } of nodes) {
    const line = lines.at(-1);
    const end = line?.at(-1);
    const isNear = end && Math.hypot(pose.x - end.x, pose.y - end.y) < GAP_M;
    if (!line || !end || !isNear) lines.push([pose]);
    else if (line.length > PIECE) lines.push([end, pose]);
    else line.push(pose);
  }
  return lines.filter((poses) => poses.length > 1).map((poses) => {
    const [xs, ys] = [poses.map((pose) => pose.x), poses.map((pose) => pose.y)];
    return { vehicle: nodes[0].vehicle_id, xy: Float32Array.from(poses.flatMap((pose) => [pose.x, pose.y])), bounds: [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)] };
  });
}
