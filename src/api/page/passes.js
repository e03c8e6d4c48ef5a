// The passes by an alert's place in time, each a mark: what it saw. A click shows its scan on the map.

import { mark, make } from "./dom.js";
import { clock, time } from "./format.js";
import { alertPath, getIfThere } from "./http.js";
import { vehicleColour } from "./palette.js";
import { hideScan, showScan } from "./map_scan.js";
import { TEXTS } from "./texts.js";

/** @typedef {import("./types").Pass} Pass */

const OUTCOMES = ["old_state", "new_state", "could_not_see"];

export class Passes {
  /** @param {import("./types").Alert} alert */
  constructor(alert) {
    this.alert = alert;
    this.element = make("section", "passes");
    this.element.setAttribute("aria-label", TEXTS.passesTitle);
    /** @type {Map<string, HTMLButtonElement>} */
    this.marks = new Map();
    this.key = "";
  }

  async bring() {
    const page = await getIfThere(alertPath(this.alert.id) + "/passes").catch(() => null);
    const items = /** @type {Pass[]} */ (page?.items ?? []);
    const key = JSON.stringify(items);
    if (key === this.key) return;
    this.key = key;
    if (items.length === 0) { this.element.replaceChildren(); return; }
    const vehicles = [...new Set(items.map((pass) => pass.vehicle_id))];
    const side = (/** @type {string} */ name) => make("ol", "strip " + name, ...items.filter((pass) => pass.side === name).map((pass) => make("li", "", this.markOf(pass))));
    const [before, since] = [side("before"), side("since")];
    before.setAttribute("aria-label", TEXTS.shows.before);
    since.setAttribute("aria-label", TEXTS.shows.since);
    this.caption = make("p", "quiet", TEXTS.passHint);
    this.element.replaceChildren(make("h3", "", TEXTS.passesTitle),
      make("div", "strips", make("span", "quiet", TEXTS.shows.before), before, make("span", "quiet", TEXTS.shows.since), since), this.caption, legend(vehicles));
  }

  /** @param {Pass} pass */
  markOf(pass) {
    const known = pass.trip_id + pass.begins_at;
    const made = this.marks.get(known) ?? make("button");
    this.marks.set(known, made);
    const words = pass.vehicle_id + " " + TEXTS.outcomes[pass.outcome] + ", " + clock(pass.begins_at);
    made.type = "button";
    made.className = "pass " + pass.outcome;
    made.setAttribute("aria-label", words);
    made.title = words;
    made.style.setProperty("--vehicle", vehicleColour(pass.vehicle_id));
    mark(made, "aria-pressed", made.getAttribute("aria-pressed") ?? "false");
    made.onclick = () => this.choose(pass, made);
    return made;
  }

  /**
   * Shows the pass's scan on the map, or takes it away again.
   * @param {Pass} pass
   * @param {HTMLButtonElement} made
   */
  choose(pass, made) {
    const isShown = made.getAttribute("aria-pressed") === "true";
    for (const other of this.marks.values()) mark(other, "aria-pressed", "false");
    if (isShown || pass.node_id === null) {
      hideScan();
      this.caption?.replaceChildren(isShown ? TEXTS.passHint : TEXTS.noScan);
      return;
    }
    mark(made, "aria-pressed", "true");
    this.caption?.replaceChildren(pass.vehicle_id + ", " + pass.trip_id + ", ", time(pass.begins_at), ": " + TEXTS.outcomes[pass.outcome]);
    showScan(this.alert.route_id, pass.node_id, vehicleColour(pass.vehicle_id)).catch((error) => this.caption?.replaceChildren(error.message));
  }
}

/** @param {string[]} vehicles */
function legend(vehicles) {
  const outcomes = OUTCOMES.map((outcome) => make("span", "legend", make("span", "pass " + outcome), TEXTS.outcomes[outcome]));
  const colours = vehicles.map((vehicle) => {
    const swatch = make("span", "swatch");
    swatch.style.setProperty("--vehicle", vehicleColour(vehicle));
    return make("span", "legend", swatch, vehicle);
  });
  return make("p", "quiet legends", ...outcomes, ...colours);
}
