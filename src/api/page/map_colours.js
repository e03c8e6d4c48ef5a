// Tiles in the page's colours: free and occupied cells as light or dark has them, or what differs between two maps.

import { dark, palette } from "./palette.js";

/** A cell is occupied if its pixel is darker. */
const OCCUPIED_BELOW = 128;

/** @param {string} hex as #rrggbb */
const rgb = (hex) => [1, 3, 5].map((k) => Number.parseInt(hex.slice(k, k + 2), 16));

/** @param {ImageBitmap} bitmap */
function pixelsOf(bitmap) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  if (!pen) throw new Error("no canvas");
  pen.drawImage(bitmap, 0, 0);
  return { canvas, pen, picture: pen.getImageData(0, 0, canvas.width, canvas.height) };
}

/**
 * A tile as it is, which is light, or in the colours of a dark page.
 * @param {ImageBitmap} bitmap
 */
export function inPageColours(bitmap) {
  if (!dark.matches) return bitmap;
  const { canvas, pen, picture } = pixelsOf(bitmap);
  const [free, occupied] = [rgb(palette().free), rgb(palette().occupied)];
  const { data } = picture;
  for (let k = 0; k < data.length; k += 4) {
    const light = data[k] / 255;
    for (let c = 0; c < 3; c += 1) data[k + c] = occupied[c] + (free[c] - occupied[c]) * light;
  }
  pen.putImageData(picture, 0, 0);
  return canvas;
}

/**
 * What of a tile differs from the same tile of another map: occupied cells that were added, those that were
 * removed, and the others faintly.
 * @param {ImageBitmap} before
 * @param {ImageBitmap} after
 */
export function difference(before, after) {
  const { canvas, pen, picture } = pixelsOf(after);
  const { data } = picture;
  const old = pixelsOf(before).picture.data;
  const colours = { added: rgb(palette().appeared), removed: rgb(palette().gone), kept: rgb(palette().quiet), free: rgb(palette().free) };
  const isOccupied = (/** @type {Uint8ClampedArray} */ of, /** @type {number} */ k) => of[k + 3] > 0 && of[k] < OCCUPIED_BELOW;
  for (let k = 0; k < data.length; k += 4) {
    const [was, is] = [isOccupied(old, k), isOccupied(data, k)];
    const colour = is ? (was ? colours.kept : colours.added) : was ? colours.removed : colours.free;
    for (let c = 0; c < 3; c += 1) data[k + c] = colour[c];
    if (was) data[k + 3] = 255;
  }
  pen.putImageData(picture, 0, 0);
  return canvas;
}
