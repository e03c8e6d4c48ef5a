// What was observed at an alert's place before and since, and which passes saw it.

import { button, make } from "/dom.js";
import { getIfThere } from "/http.js";
import { time } from "/format.js";
import { TEXTS } from "/texts.js";

const BLINK_MS = 700;
const still = matchMedia("(prefers-reduced-motion: reduce)");

export class Evidence {
  constructor(alert) {
    this.path = "/v1/alerts/" + alert.id;
    this.show = "both";
    this.picture = make("img", "evidence");
    this.picture.addEventListener("error", () => this.fallBack());
    this.buttons = Object.entries(TEXTS.shows).map(([show, text]) => {
      const made = button(text, () => { this.stopBlinking(); this.choose(show); });
      made.dataset.show = show;
      return made;
    });
    this.blinker = button(TEXTS.blink, () => this.blink());
    this.blinker.setAttribute("aria-pressed", "false");
    this.choices = make("div", "row shows", ...this.buttons, this.blinker);
    this.passes = make("div", "passes");
    this.element = make("div", "", this.choices, this.picture, this.passes);
  }

  /** Reads pictures and passes anew when the alert has changed. */
  bring(alert) {
    this.revision = alert.revision;
    this.choose(this.show);
    this.showPasses().catch(() => this.passes.replaceChildren());
  }

  choose(show) {
    this.show = show;
    for (const made of this.buttons) made.setAttribute("aria-pressed", String(made.dataset.show === show));
    // Another query for another revision: the picture is read anew.
    const path = this.hasOnlyScans ? this.path + "/evidence.svg" : this.path + "/observations.svg?show=" + show;
    this.picture.src = this.hasOnlyScans ? path : path;
    this.picture.alt = this.hasOnlyScans ? TEXTS.scans : TEXTS.evidenceAlt(TEXTS.shows[show]);
  }

  /** Two scans are all that there is to show. */
  fallBack() {
    if (this.hasOnlyScans) { this.picture.hidden = true; return; }
    this.hasOnlyScans = true;
    this.choices.hidden = true;
    this.stopBlinking();
    this.choose(this.show);
  }

  blink() {
    if (this.timer) { this.stopBlinking(); return; }
    this.blinker.setAttribute("aria-pressed", "true");
    this.choose("before");
    if (still.matches) return;
    this.timer = setInterval(() => {
      if (!this.element.isConnected) this.stopBlinking();
      else this.choose(this.show === "before" ? "since" : "before");
    }, BLINK_MS);
  }

  stopBlinking() {
    clearInterval(this.timer);
    this.timer = null;
    this.blinker.setAttribute("aria-pressed", "false");
  }

  async showPasses() {
    const page = await getIfThere(this.path + "/passes");
    if (!page || page.items.length === 0) { this.passes.replaceChildren(); return; }
    const marks = page.items.map((pass) => {
      const mark = make("li", "pass " + pass.outcome + " " + pass.side);
      const words = pass.vehicle_id + " " + TEXTS.outcomes[pass.outcome] + ", ";
      mark.append(make("span", "unseen", words, time(pass.begins_at)));
      mark.title = words + time(pass.begins_at).textContent + ", " + pass.trip_id;
      return mark;
    });
    const legend = Object.entries(TEXTS.outcomes).map(([outcome, text]) => make("span", "legend", make("span", "pass " + outcome), text));
    this.passes.replaceChildren(make("h3", "", TEXTS.passes), make("ol", "strip", ...marks), make("p", "quiet legends", ...legend));
  }
}
