// The places of alerts on the map with the numbers of their cards, and the scale bar.

import { screenX, screenY, view } from "./map_view.js";
import { palette } from "./palette.js";
import { shownAlerts } from "./shown.js";
import { isPending, state } from "./state.js";

/** @typedef {import("./types").Alert} Alert */

const SCALES_M = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500];
const NUMBER_ABOVE_PX = 18;
const REACH_PX = 24;

/** @type {Record<string, string>} */
const INKS = { appeared: "appeared", disappeared: "gone" };
/** @param {Alert} alert */
const inkOf = (alert) => palette()[INKS[alert.kind] ?? "doubt"];

/** Alerts of the chosen route with the numbers of their cards. */
const here = () => shownAlerts().map((alert, k) => ({ alert, number: k + 1 })).filter(({ alert }) => alert.route_id === state.route && alert.region.length > 2);

/** @param {CanvasRenderingContext2D} pen */
export function drawMarks(pen) {
  const all = here();
  // The chosen one lies above the others.
  for (const { alert } of all) drawRegion(pen, alert);
  for (const { alert, number } of all) if (alert.id !== state.chosen) drawNumber(pen, alert, number);
  for (const { alert, number } of all) if (alert.id === state.chosen) drawNumber(pen, alert, number);
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Alert} alert
 */
function drawRegion(pen, alert) {
  pen.beginPath();
  for (const [x, y] of alert.region) pen.lineTo(screenX(x), screenY(y));
  pen.closePath();
  pen.globalAlpha = isPending(alert) ? 0.25 : 0.1;
  pen.fillStyle = inkOf(alert);
  pen.fill();
  pen.globalAlpha = 1;
  pen.strokeStyle = inkOf(alert);
  pen.lineWidth = alert.id === state.chosen ? 4 : 2;
  pen.setLineDash(alert.tier === "tentative" ? [5, 4] : []);
  pen.stroke();
  pen.setLineDash([]);
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Alert} alert
 * @param {number} number
 */
function drawNumber(pen, alert, number) {
  const isChosen = alert.id === state.chosen;
  const [x, y] = [screenX(alert.location.x), screenY(alert.location.y) - NUMBER_ABOVE_PX];
  pen.font = "600 12px system-ui, sans-serif";
  const half = Math.max(10, pen.measureText(String(number)).width / 2 + 6);
  pen.beginPath();
  pen.roundRect(x - half, y - 10, 2 * half, 20, 10);
  pen.fillStyle = inkOf(alert);
  pen.fill();
  pen.strokeStyle = isChosen ? palette().ink : palette().paper;
  pen.lineWidth = isChosen ? 3 : 1;
  pen.stroke();
  pen.fillStyle = palette()["on-mark"];
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(String(number), x, y + 0.5);
  pen.textAlign = "left";
}

/**
 * The alert whose place was clicked, or whose number hangs near it.
 * @param {number} px
 * @param {number} py
 */
export function alertAt(px, py) {
  const away = (/** @type {Alert} */ { location }, /** @type {number} */ above) => Math.hypot(screenX(location.x) - px, screenY(location.y) - above - py);
  const near = here().map(({ alert }) => ({ alert, px: Math.min(away(alert, 0), away(alert, NUMBER_ABOVE_PX)) })).filter((found) => found.px < REACH_PX);
  return near.sort((a, b) => a.px - b.px)[0]?.alert;
}

/** @param {CanvasRenderingContext2D} pen */
export function drawScale(pen) {
  const length = SCALES_M.findLast((metres) => metres * view.scale <= view.width / 4) ?? SCALES_M[0];
  const [pixels, bottom] = [length * view.scale, view.height];
  pen.globalAlpha = 0.85;
  pen.fillStyle = palette().paper;
  pen.fillRect(8, bottom - 34, pixels + 16, 26);
  pen.globalAlpha = 1;
  pen.fillStyle = pen.strokeStyle = palette().ink;
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(16, bottom - 18);
  pen.lineTo(16, bottom - 13);
  pen.lineTo(16 + pixels, bottom - 13);
  pen.lineTo(16 + pixels, bottom - 18);
  pen.stroke();
  pen.font = "11px system-ui, sans-serif";
  pen.textBaseline = "alphabetic";
  pen.fillText(length + " m", 20, bottom - 19);
}
