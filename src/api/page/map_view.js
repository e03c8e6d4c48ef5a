// What part of the map is seen: metres to pixels and back, zooming, fitting. No drawing.

/**
 * @typedef {import("./types").Point} Point
 * @typedef {{x: number, y: number, scale: number, width: number, height: number}} Window
 */

/** Pixels a metre at the tiles' zoom 8, which is 5 cm a pixel. */
const SCALE_AT_8 = 20;
const SCALE_MIN = 0.05;
const SCALE_MAX = 800;
const FIT_MARGIN = 0.92;

/** @type {Window} what lies in the middle, metres; pixels a metre; the size in pixels */
export const view = { x: 0, y: 0, scale: SCALE_AT_8, width: 1, height: 1 };

/** @type {Set<() => void>} */
const listeners = new Set();

/**
 * Calls `listener` whenever there is something else to be seen.
 * @param {() => void} listener
 */
export const whenMoved = (listener) => listeners.add(listener);
export function moved() {
  for (const listener of listeners) listener();
}

/** @param {number} x map, metres */
export const screenX = (x) => view.width / 2 + (x - view.x) * view.scale;
/** @param {number} y map, metres */
export const screenY = (y) => view.height / 2 - (y - view.y) * view.scale;

/**
 * @param {number} px
 * @param {number} py
 * @returns {Point} map, metres
 */
export const toMap = (px, py) => ({ x: view.x + (px - view.width / 2) / view.scale, y: view.y - (py - view.height / 2) / view.scale });

/** @param {number} scale */
const bounded = (scale) => Math.min(SCALE_MAX, Math.max(SCALE_MIN, scale));

/** The zoom of tiles, in fractions. */
export const zoomLevel = () => 8 + Math.log2(view.scale / SCALE_AT_8);

/**
 * @param {Point} centre
 * @param {number} z zoom of tiles
 */
export function moveTo(centre, z) {
  Object.assign(view, { x: centre.x, y: centre.y, scale: bounded(SCALE_AT_8 * 2 ** (z - 8)) });
  moved();
}

/**
 * @param {number} dx pixels to the right
 * @param {number} dy pixels downwards
 */
export function panBy(dx, dy) {
  view.x -= dx / view.scale;
  view.y += dy / view.scale;
  moved();
}

/**
 * Zooms about a place on the screen, which stays where it is.
 * @param {number} factor
 * @param {number} px
 * @param {number} py
 */
export function zoomBy(factor, px = view.width / 2, py = view.height / 2) {
  const before = toMap(px, py);
  view.scale = bounded(view.scale * factor);
  const after = toMap(px, py);
  view.x += before.x - after.x;
  view.y += before.y - after.y;
  moved();
}

/** @param {readonly [number, number, number, number]} bounds x0, y0, x1, y1, metres */
export function fitTo([x0, y0, x1, y1]) {
  const scale = FIT_MARGIN * Math.min(view.width / Math.max(x1 - x0, 1), view.height / Math.max(y1 - y0, 1));
  Object.assign(view, { x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale: bounded(scale) });
  moved();
}
