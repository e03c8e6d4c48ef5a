// What was observed at an alert's place: before, since, both, faded into each other, or blinking.

import { button, make, mark } from "./dom.js";
import { alertPath, getBlob } from "./http.js";
import { TEXTS } from "./texts.js";

const BLINK_MS = 700;
const SHOWS = ["before", "since", "both"];
const still = matchMedia("(prefers-reduced-motion: reduce)");

export class Evidence {
  /** @param {string} id of the alert */
  constructor(id) {
    this.path = alertPath(id);
    this.show = "both";
    /** @type {AbortController | undefined} */
    this.reading = undefined;
    /** @type {ReturnType<typeof setInterval> | undefined} */
    this.timer = undefined;
    /** @type {Map<string, HTMLImageElement>} */
    this.pictures = new Map(SHOWS.map((show) => [show, picture(TEXTS.evidenceAlt(TEXTS.shows[show]))]));
    this.buttons = SHOWS.map((show) => {
      const made = button(TEXTS.shows[show], () => { this.stopBlinking(); this.choose(show); });
      made.dataset.show = show;
      return made;
    });
    this.blinker = button(TEXTS.blink, () => (this.timer === undefined ? this.blink() : this.stopBlinking()));
    this.fader = make("input", "fader");
    Object.assign(this.fader, { type: "range", min: "0", max: "100", value: "0" });
    this.fader.setAttribute("aria-label", TEXTS.fade);
    this.fader.addEventListener("input", () => { this.stopBlinking(); this.fade(Number(this.fader.value) / 100); });
    this.choices = make("div", "row shows", ...this.buttons, this.blinker, this.fader);
    this.waiting = make("p", "quiet", TEXTS.reading);
    this.stack = make("div", "stack", this.waiting, ...this.pictures.values());
    this.legend = legend();
    this.scans = make("div", "scans");
    this.element = make("section", "", this.choices, this.stack, this.legend, this.scans);
    this.element.setAttribute("aria-label", TEXTS.evidence);
    mark(this.blinker, "aria-pressed", "false");
    this.choose("both");
  }

  /** Reads the pictures, which have changed, one after the other; those on show stay until the new ones are there. */
  async bring() {
    this.stop();
    const reading = new AbortController();
    this.reading = reading;
    try {
      for (const show of ["both", "before", "since"]) await load(this.pictures.get(show), this.path + "/observations.svg?show=" + show, reading.signal).then(() => { this.waiting.hidden = true; });
    } catch {
      if (!reading.signal.aborted && !this.pictures.get("both")?.src) await this.fallBack(reading.signal);
    }
  }

  /** Ends what is being read: another alert is shown, or this one has changed. */
  stop() {
    this.reading?.abort();
  }

  /**
   * Where not all observations are known: two scans that disagree.
   * @param {AbortSignal} signal
   */
  async fallBack(signal) {
    for (const part of [this.choices, this.stack, this.legend]) part.hidden = true;
    const shown = picture(TEXTS.scans);
    try {
      await load(shown, this.path + "/evidence.svg", signal);
      this.scans.replaceChildren(shown);
    } catch {
      this.scans.replaceChildren(make("p", "quiet", TEXTS.noEvidence));
    }
  }

  /** @param {string} show */
  choose(show) {
    this.show = show;
    for (const made of this.buttons) mark(made, "aria-pressed", String(made.dataset.show === show));
    for (const [name, shown] of this.pictures) shown.style.opacity = name === show ? "1" : "0";
    for (const [name, shown] of this.pictures) mark(shown, "aria-hidden", name === show ? null : "true");
    if (show !== "both") this.fader.value = show === "before" ? "0" : "100";
  }

  /**
   * Lays what was since over what was before.
   * @param {number} share of since
   */
  fade(share) {
    this.choose(share < 0.5 ? "before" : "since");
    this.fader.value = String(Math.round(share * 100));
    const [before, since] = ["before", "since"].map((show) => this.pictures.get(show));
    if (before) before.style.opacity = "1";
    if (since) since.style.opacity = String(share);
  }

  /** Shows the two states in turn; with reduced motion each press shows the other one. */
  blink() {
    const turn = () => this.choose(this.show === "before" ? "since" : "before");
    turn();
    if (still.matches) return;
    mark(this.blinker, "aria-pressed", "true");
    this.timer = setInterval(() => (this.element.isConnected ? turn() : this.stopBlinking()), BLINK_MS);
  }

  stopBlinking() {
    clearInterval(this.timer);
    this.timer = undefined;
    mark(this.blinker, "aria-pressed", "false");
  }
}

/** @param {string} alt */
function picture(alt) {
  const made = make("img", "evidence");
  made.alt = alt;
  made.hidden = true;
  return made;
}

/**
 * @param {HTMLImageElement | undefined} shown
 * @param {string} path
 * @param {AbortSignal} signal
 */
async function load(shown, path, signal) {
  const address = URL.createObjectURL(placeAlone(await (await getBlob(path, signal)).text()));
  if (!shown) return;
  if (shown.src) URL.revokeObjectURL(shown.src);
  shown.src = address;
  shown.hidden = false;
}

/**
 * A picture without title and legend, which the page has itself: its view `place`, if it has one.
 * @param {string} text
 */
function placeAlone(text) {
  const picture = new DOMParser().parseFromString(text, "image/svg+xml");
  const box = picture.getElementById("place")?.getAttribute("viewBox");
  const [, , width, height] = box?.split(" ") ?? [];
  const root = picture.documentElement;
  for (const [name, value] of Object.entries({ viewBox: box, width, height })) if (value) root.setAttribute(name, value);
  return new Blob([new XMLSerializer().serializeToString(picture)], { type: "image/svg+xml" });
}

/** What the colours of the pictures mean. */
function legend() {
  const entries = Object.entries(TEXTS.evidenceLegend).map(([name, text]) => make("span", "legend", make("span", "swatch hit-" + name), text));
  return make("p", "quiet legends", ...entries);
}
