// A route's versions: who began each and why, what differs, its files, releasing and retiring it.

import { alertAddress, routeAddress } from "./address.js";
import { ask, toast, toastError } from "./dialog.js";
import { button, facts, link, make, noteField } from "./dom.js";
import { time } from "./format.js";
import { get, list, routePath, send } from "./http.js";
import { showPicture } from "./map.js";
import { may } from "./state.js";
import { TEXTS } from "./texts.js";

/** @typedef {import("./types").Version} Version */

const SHOWN_MAX = 200;
const T = TEXTS.versions;
const FILES = ["png", "pgm", "yaml"];

/** @param {Version} version */
const stateOf = (version) => version.state ?? (version.current ? "draft" : "retired");

/**
 * @param {string} route
 * @param {Version} version
 */
function files(route, version) {
  const base = routePath(route) + "/versions/" + version.version;
  const links = FILES.map((kind) => link(kind.toUpperCase(), base + "/map." + kind));
  if (stateOf(version) === "released") links.push(link("VDA 5050", base + "/vda5050?vda5050=2.1"));
  return make("span", "files", ...links);
}

/**
 * @param {string} route
 * @param {Version} version
 * @param {string} action release or retire
 * @param {() => void} again
 */
function changeButton(route, version, action, again) {
  return button(T.actions[action], async () => {
    const { area, field } = noteField(TEXTS.note, "");
    const isSure = await ask(T.asks[action](version.version), [make("p", "", T.says[action]), field], [[TEXTS.cancel, null], [T.actions[action], true, "main"]]);
    if (!isSure) return;
    const note = area.value.trim();
    try {
      await send("POST", routePath(route) + "/versions/" + version.version + "/" + action, note ? { note } : {});
      toast(T.done[action](version.version));
      again();
    } catch (error) {
      toastError(error);
    }
  });
}

/**
 * A link to the map that shows that picture of it.
 * @param {string} route
 * @param {string} text
 * @param {string} picture
 */
function onMap(route, text, picture) {
  const made = link(text, routeAddress(route, "map"));
  // The map of the route is there once the address has been followed.
  made.addEventListener("click", () => addEventListener("hashchange", () => setTimeout(() => showPicture(picture)), { once: true }));
  return made;
}

/**
 * How many cells differ from the version before, read when it is opened.
 * @param {string} route
 * @param {Version} version
 */
function differenceInNumbers(route, version) {
  const fold = make("details", "", make("summary", "", T.numbers));
  fold.addEventListener("toggle", async () => {
    if (!fold.open || fold.childElementCount > 1) return;
    try {
      /** @type {import("./types").VersionDifference} */
      const found = await get(routePath(route) + "/versions/" + version.version + "/diff?from=" + (version.version - 1));
      const alerts = make("span", "files", ...found.alerts.map((id) => link(id.slice(-6), alertAddress(id))));
      fold.append(facts([...Object.entries(found.cells).map(([name, count]) => /** @type {[string, string]} */ ([T.cells[name] ?? name, String(count)])), [T.accepted, found.alerts.length > 0 ? alerts : null]]));
    } catch (error) {
      fold.append(make("p", "refusal", error instanceof Error ? error.message : String(error)));
    }
  });
  return fold;
}

/**
 * @param {string} route
 * @param {Version} version
 * @param {() => void} again
 */
function item(route, version, again) {
  const { cause } = version;
  const why = cause?.alert_id ? link(T.causes[cause.action] ?? cause.action, alertAddress(cause.alert_id)) : T.causes[cause?.action ?? ""] ?? cause?.action;
  const state = stateOf(version);
  const title = make("h3", "", T.title(version.version), " ", make("span", "state state-" + state, T.states[state] ?? state), version.current ? make("span", "quiet", " " + T.current) : null);
  const mayRelease = may("maintainer") && version.current && state === "draft";
  const mayRetire = may("maintainer") && state === "released";
  return make("li", "version", title, facts([
    [T.began, time(version.created_at)],
    [T.ended, version.superseded_at ? time(version.superseded_at) : null],
    [T.released, version.released ? make("span", "", time(version.released.at), ", " + version.released.by + (version.released.note ? ": " + version.released.note : "")) : null],
    [T.retired, version.retired_at ? time(version.retired_at) : null],
    [T.cause, why],
    [T.by, cause?.by],
    [TEXTS.noteShort, cause?.note],
    [T.moved, typeof version.max_displacement_m === "number" ? TEXTS.preview.atMost(version.max_displacement_m) : null],
    [T.hash, version.sha256],
    [T.files, files(route, version)],
  ]), make("div", "row", onMap(route, T.onMap, version.current ? "accepted" : String(version.version)),
    version.version > 1 ? onMap(route, T.difference(version.version - 1), version.version + "-" + (version.version - 1)) : null, mayRelease ? changeButton(route, version, "release", again) : null, mayRetire ? changeButton(route, version, "retire", again) : null),
  version.version > 1 ? differenceInNumbers(route, version) : null);
}

/**
 * @param {string} route
 * @param {() => void} again
 */
export async function versions(route, again) {
  const items = /** @type {Version[]} */ (await list(routePath(route) + "/versions", SHOWN_MAX));
  if (items.length === 0) return make("p", "quiet", TEXTS.nothing);
  return make("ol", "versions", ...items.sort((a, b) => b.version - a.version).map((version) => item(route, version, again)));
}
