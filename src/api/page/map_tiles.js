// The map's picture in tiles: which are seen, reading them, keeping them by version, and drawing them.

import { getBlob, getTagged, Refused, routePath } from "./http.js";
import { difference, inPageColours } from "./map_colours.js";
import { moved, view } from "./map_view.js";
import { dark } from "./palette.js";

/**
 * @typedef {{image: ImageBitmap | HTMLCanvasElement | null, tag: string, used: number, notBefore: number}} Tile
 * @typedef {object} Source
 * @property {string} route
 * @property {string} picture what is shown, by the name that it keeps while the map grows
 * @property {string} query which map that is now
 * @property {string | null} against the map that it is compared with
 * @property {import("./types").TilesInfo} info
 * @property {string} tag changes with the map
 */

const TILE_PX = 256;
/** Zoom 8 is 5 cm a pixel. */
const TILE_AT_8_M = 0.05 * TILE_PX;
const KEPT_MAX = 300;
/** The service draws as many at once. */
const AT_ONCE = 2;
/** A tile that could not be read is asked for again after so long. */
const RETRY_MS = 10000;
/** A missing tile is stood in for by one up to so many levels above it. */
const STAND_INS = 5;

/** @type {Map<string, Tile>} */
const tiles = new Map();
/** @type {Source | null} */
let source = null;
/** @type {Set<string>} tiles that are being read */
const underWay = new Set();
/** @type {{z: number, x: number, y: number, key: string}[]} */
let wanted = [];
let frame = 0;

dark.addEventListener("change", () => { tiles.clear(); moved(); });

/**
 * Reads what there is of a map, and again whenever it may have changed.
 * @param {string} route
 * @param {string} picture
 * @param {string} query
 * @param {string | null} against
 * @returns {Promise<import("./types").TilesInfo | null>} null while there is no map
 */
export async function readTiles(route, picture, query, against) {
  let answer;
  try {
    answer = await getTagged(routePath(route) + "/map/tiles.json" + query);
  } catch (error) {
    if (!(error instanceof Refused) || error.status !== 404) throw error;
    answer = null;
  }
  if (source?.route !== route || source.picture !== picture) tiles.clear();
  source = answer && { route, picture, query, against, info: answer.body, tag: String(answer.body.tag ?? answer.tag) };
  moved();
  return source?.info ?? null;
}

/** Forgets the map of another route. */
export function dropTiles() {
  source = null;
  tiles.clear();
}

/**
 * Draws the tiles that are seen; the pen measures in device pixels.
 * @param {CanvasRenderingContext2D} pen
 * @param {number} ratio device pixels a pixel
 */
export function drawTiles(pen, ratio) {
  if (!source) return;
  frame += 1;
  wanted = [];
  const { min_zoom, max_zoom } = source.info;
  const scale = view.scale * ratio;
  const z = Math.min(max_zoom, Math.max(min_zoom, Math.ceil(8 + Math.log2((scale * TILE_AT_8_M) / TILE_PX) - 0.3)));
  const tile_m = TILE_AT_8_M * 2 ** (8 - z);
  const half = { x: view.width / 2 / view.scale, y: view.height / 2 / view.scale };
  const seen = clip(Math.floor((view.x - half.x) / tile_m), Math.floor((view.x + half.x) / tile_m), Math.floor((-view.y - half.y) / tile_m), Math.floor((-view.y + half.y) / tile_m), tile_m);
  const left = (/** @type {number} */ x) => Math.round((view.width * ratio) / 2 + (x * tile_m - view.x) * scale);
  const top = (/** @type {number} */ y) => Math.round((view.height * ratio) / 2 + (y * tile_m + view.y) * scale);
  pen.imageSmoothingEnabled = (scale * tile_m) / TILE_PX < 1;
  for (let y = seen.y0; y <= seen.y1; y += 1) {
    for (let x = seen.x0; x <= seen.x1; x += 1) drawTile(pen, z, x, y, left(x), top(y), left(x + 1), top(y + 1));
  }
  readWanted();
}

/**
 * Of the tiles in the window those that the map reaches.
 * @param {number} x0
 * @param {number} x1
 * @param {number} y0
 * @param {number} y1
 * @param {number} tile_m
 */
function clip(x0, x1, y0, y1, tile_m) {
  const bounds = source?.info.bounds;
  if (!bounds) return { x0, x1, y0, y1 };
  return {
    x0: Math.max(x0, Math.floor(bounds[0] / tile_m)), x1: Math.min(x1, Math.floor(bounds[2] / tile_m)),
    y0: Math.max(y0, Math.floor(-bounds[3] / tile_m)), y1: Math.min(y1, Math.floor(-bounds[1] / tile_m)),
  };
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {number} z
 * @param {number} x
 * @param {number} y
 * @param {number} left
 * @param {number} top
 * @param {number} right
 * @param {number} bottom
 */
function drawTile(pen, z, x, y, left, top, right, bottom) {
  const key = z + "/" + x + "/" + y;
  const tile = tiles.get(key);
  if (!tile || (tile.tag !== source?.tag && performance.now() > tile.notBefore)) wanted.push({ z, x, y, key });
  if (tile) {
    tile.used = frame;
    if (tile.image) pen.drawImage(tile.image, left, top, right - left, bottom - top);
    return;
  }
  for (let up = 1; up <= STAND_INS; up += 1) {
    const parts = 2 ** up;
    const parent = tiles.get(z - up + "/" + Math.floor(x / parts) + "/" + Math.floor(y / parts));
    if (!parent) continue;
    const part = TILE_PX / parts;
    const [column, row] = [x - Math.floor(x / parts) * parts, y - Math.floor(y / parts) * parts];
    if (parent.image) pen.drawImage(parent.image, column * part, row * part, part, part, left, top, right - left, bottom - top);
    return;
  }
}

function readWanted() {
  for (const { z, x, y, key } of wanted) {
    if (underWay.size >= AT_ONCE) return;
    if (source && !underWay.has(key)) read(source, z, x, y, key);
  }
}

/**
 * @param {Source} from
 * @param {number} z
 * @param {number} x
 * @param {number} y
 * @param {string} key
 */
async function read(from, z, x, y, key) {
  underWay.add(key);
  /** @type {Tile["image"]} */
  let image = tiles.get(key)?.image ?? null;
  let isRead = true;
  try {
    const [after, before] = await Promise.all([readOne(from.route, key, from.query), from.against === null ? null : readOne(from.route, key, from.against)]);
    image = before ? difference(before, after) : inPageColours(after);
  } catch {
    isRead = false;
  } finally {
    underWay.delete(key);
  }
  if (source?.route === from.route && source.picture === from.picture) tiles.set(key, { image, tag: isRead ? from.tag : "", used: frame, notBefore: isRead ? 0 : performance.now() + RETRY_MS });
  forget();
  moved();
}

/**
 * @param {string} route
 * @param {string} key
 * @param {string} query
 */
const readOne = async (route, key, query) => createImageBitmap(await getBlob(routePath(route) + "/map/tiles/" + key + ".png" + query));

/** Drops the tiles that were not seen for the longest time. */
function forget() {
  if (tiles.size <= KEPT_MAX) return;
  const oldest = [...tiles].sort(([, a], [, b]) => a.used - b.used).slice(0, tiles.size - KEPT_MAX);
  for (const [key] of oldest) tiles.delete(key);
}
