// Painting the layers: trajectories, edges by residual, references, last poses; only what a window shows.

import { found, isShown, RAMP } from "./map_layers.js";
import { palette, vehicleColour } from "./palette.js";

/** @typedef {import("./map_view.js").Window} Window */

const SEGMENTS_A_TURN = 2000;

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Window} window
 */
export function* paintLayers(pen, window) {
  if (isShown("residuals")) yield* paintEdges(pen, window);
  if (isShown("trajectories")) yield* paintTracks(pen, window);
  if (isShown("references")) paintReferences(pen, window);
  if (isShown("vehicles")) paintVehicles(pen, window);
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
  for (const { vehicle, xy, bounds } of found.pieces) {
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
  for (let k = 0; k < found.decades.length; k += 1) {
    const [x0, y0, x1, y1] = [found.edges[4 * k], found.edges[4 * k + 1], found.edges[4 * k + 2], found.edges[4 * k + 3]];
    if (Math.max(x0, x1) < seen.x0 || Math.min(x0, x1) > seen.x1 || Math.max(y0, y1) < seen.y0 || Math.min(y0, y1) > seen.y1) continue;
    if (found.decades[k] !== decade || since > SEGMENTS_A_TURN) {
      if (decade >= 0) pen.stroke();
      if (since > SEGMENTS_A_TURN) { since = 0; yield; }
      decade = found.decades[k];
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
  for (let k = 0; k < found.references.length; k += 2) {
    pen.fillRect(window.width / 2 + (found.references[k] - window.x) * window.scale - 2, window.height / 2 - (found.references[k + 1] - window.y) * window.scale - 2, 4, 4);
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
  for (const { vehicle, x, y, towards } of found.last) {
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
