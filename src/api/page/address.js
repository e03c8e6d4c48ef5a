// What the address says: which alert, which tab of which route at which place, which report.

/**
 * @typedef {object} Address
 * @property {"inbox" | "alert" | "route" | "report"} at
 * @property {string | null} name the alert's id or the route's
 * @property {string} tab
 * @property {URLSearchParams} query
 */

/**
 * @param {string} hash as `location.hash`
 * @returns {Address}
 */
export function readAddress(hash) {
  const [path, query = ""] = hash.replace(/^#\/?/, "").split("?");
  const [first, name, tab] = path.split("/").map(decode);
  const at = first === "alerts" && name ? "alert" : first === "routes" && name ? "route" : first === "report" ? "report" : "inbox";
  return { at, name: name || null, tab: tab || "map", query: new URLSearchParams(query) };
}

/** @param {string} part */
function decode(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/** @param {string} id */
export const alertAddress = (id) => "#/alerts/" + encodeURIComponent(id);

/**
 * @param {string} route
 * @param {string} tab
 */
export const routeAddress = (route, tab) => "#/routes/" + encodeURIComponent(route) + "/" + tab;

/**
 * A place on a route's map: metres, and the zoom of tiles.
 * @param {string} route
 * @param {{x: number, y: number, z: number}} place
 */
export const placeAddress = (route, { x, y, z }) => routeAddress(route, "map") + "?x=" + x.toFixed(2) + "&y=" + y.toFixed(2) + "&z=" + z.toFixed(2);

/**
 * The place that a query names, or null.
 * @param {URLSearchParams} query
 */
export function readPlace(query) {
  const [x, y, z] = ["x", "y", "z"].map((name) => Number.parseFloat(query.get(name) ?? ""));
  return Number.isFinite(x) && Number.isFinite(y) ? { x, y, z: Number.isFinite(z) ? z : 8 } : null;
}
