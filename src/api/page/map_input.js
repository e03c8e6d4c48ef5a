// Moving over the map with mouse, fingers, wheel and keys.

import { panBy, view, zoomBy } from "./map_view.js";

/** @typedef {{x: number, y: number}} Spot pixels */

export const ZOOM_STEP = 1.3;
const KEY_STEP_PX = 60;
/** A press that moves less is a click. */
const CLICK_PX = 5;

/**
 * The distance of two pointers, and the middle between them.
 * @param {Map<number, Spot>} pointers
 */
function spread(pointers) {
  const [a, b] = [...pointers.values()];
  return { size: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {{onClick: (x: number, y: number) => void, onPoint: (x: number, y: number) => void, onFit: () => void}} on
 */
export function hearMap(canvas, { onClick, onPoint, onFit }) {
  /** @type {Map<number, Spot>} */
  const pointers = new Map();
  let way = 0;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (pointers.size === 0) way = 0;
    pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
  });
  canvas.addEventListener("pointermove", (event) => {
    onPoint(event.offsetX, event.offsetY);
    const from = pointers.get(event.pointerId);
    if (!from) return;
    const was = pointers.size === 2 ? spread(pointers) : null;
    const to = { x: event.offsetX, y: event.offsetY };
    pointers.set(event.pointerId, to);
    way += Math.hypot(to.x - from.x, to.y - from.y);
    if (!was) { panBy(to.x - from.x, to.y - from.y); return; }
    const is = spread(pointers);
    panBy(is.x - was.x, is.y - was.y);
    zoomBy(is.size / Math.max(was.size, 1), is.x, is.y);
  });
  /** @param {PointerEvent} event */
  const end = (event) => {
    const isLast = pointers.delete(event.pointerId) && pointers.size === 0;
    if (isLast && way < CLICK_PX && event.type === "pointerup") onClick(event.offsetX, event.offsetY);
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomBy(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => hearKey(event, onFit, onClick));
}

/**
 * @param {KeyboardEvent} event
 * @param {() => void} onFit
 * @param {(x: number, y: number) => void} onClick
 */
function hearKey(event, onFit, onClick) {
  /** @type {Record<string, () => void>} */
  const keys = {
    ArrowLeft: () => panBy(KEY_STEP_PX, 0),
    ArrowRight: () => panBy(-KEY_STEP_PX, 0),
    ArrowUp: () => panBy(0, KEY_STEP_PX),
    ArrowDown: () => panBy(0, -KEY_STEP_PX),
    "+": () => zoomBy(ZOOM_STEP),
    "-": () => zoomBy(1 / ZOOM_STEP),
    0: onFit,
    Enter: () => onClick(view.width / 2, view.height / 2),
  };
  const act = keys[event.key];
  if (!act || event.ctrlKey || event.metaKey) return;
  event.preventDefault();
  event.stopPropagation();
  act();
}
