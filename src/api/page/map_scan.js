// One scan at its pose over the map: what a pass saw.

import { get, routePath } from "./http.js";
import { moved, screenX, screenY } from "./map_view.js";

/** @type {{route: string, colour: string, from: import("./types").Point, xy: Float32Array} | null} */
let shown = null;
let latest = 0;

/**
 * Reads and shows the scan of a node.
 * @param {string} route
 * @param {number} node
 * @param {string} colour
 */
export async function showScan(route, node, colour) {
  latest += 1;
  const own = latest;
  /** @type {import("./types").NodeScan} */
  const scan = await get(routePath(route) + "/nodes/" + node + "/scan");
  if (own !== latest) return;
  const { x, y, theta } = compose(scan.pose, scan.lidar.mount);
  const points = scan.ranges.flatMap((range, k) => {
    if (range === null) return [];
    const angle = theta + scan.lidar.angle_min + k * scan.lidar.angle_increment;
    return [x + range * Math.cos(angle), y + range * Math.sin(angle)];
  });
  shown = { route, colour, from: { x, y }, xy: Float32Array.from(points) };
  moved();
}

export function hideScan() {
  latest += 1;
  if (!shown) return;
  shown = null;
  moved();
}

/**
 * @param {import("./types").Pose} a
 * @param {import("./types").Pose} b in a's frame
 */
function compose(a, b) {
  const [c, s] = [Math.cos(a.theta), Math.sin(a.theta)];
  return { x: a.x + c * b.x - s * b.y, y: a.y + s * b.x + c * b.y, theta: a.theta + b.theta };
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {string | null} route
 */
export function drawScan(pen, route) {
  if (!shown || shown.route !== route) return;
  const { xy, from, colour } = shown;
  const [ox, oy] = [screenX(from.x), screenY(from.y)];
  pen.strokeStyle = pen.fillStyle = colour;
  pen.globalAlpha = 0.25;
  pen.lineWidth = 1;
  pen.beginPath();
  for (let k = 0; k < xy.length; k += 2) {
    pen.moveTo(ox, oy);
    pen.lineTo(screenX(xy[k]), screenY(xy[k + 1]));
  }
  pen.stroke();
  pen.globalAlpha = 1;
  for (let k = 0; k < xy.length; k += 2) pen.fillRect(screenX(xy[k]) - 2, screenY(xy[k + 1]) - 2, 4, 4);
  pen.beginPath();
  pen.arc(ox, oy, 7, 0, 2 * Math.PI);
  pen.fill();
}
