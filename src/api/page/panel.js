// The alert that is looked at: a sentence, what can be done, and what it rests on.

import { arrange, button, byId, facts, make, say } from "/dom.js";
import { decide, isPossible } from "/decide.js";
import { Evidence } from "/evidence.js";
import { metres, middle, point, time } from "/format.js";
import { state } from "/state.js";
import { TEXTS } from "/texts.js";
import { ACTIONS, DOUBTS, KINDS, REASONS, STATUSES } from "/words.js";

const F = TEXTS.fields;
let view = null;

function summary(alert) {
  if (alert.summary) return alert.summary;
  return (KINDS.get(alert.kind) ?? alert.kind) + " at " + point(alert.location) + ", seen in " + alert.laps + " passes by " + alert.vehicle_ids.join(", ") + ".";
}

function place(alert) {
  const rows = [
    [F.where, point(alert.location) + " ± " + metres(alert.location.sigma)],
    [F.since, time(alert.since)], [F.last, time(alert.last_seen)],
    [F.vehicles, alert.vehicle_ids.join(", ")], [F.passes, String(alert.laps)],
    [F.before, alert.passes ? TEXTS.beforePasses(alert.passes.before) : null],
    [F.sure, (100 * alert.confidence).toFixed(1) + " %"],
    [F.other, alert.counterpart ? (KINDS.get(alert.counterpart.kind) + " at " + point(middle(alert.counterpart.region))) : null],
    [F.shift, alert.shift ? point(alert.shift) : null],
    [F.bands, alert.bands.map(({ from, to }) => metres(from) + " to " + metres(to)).join(", ")],
  ];
  const faults = (alert.suspect?.faults ?? []).map((fault) => make("p", "", fault.text));
  return make("div", "", ...faults, facts(rows));
}

function details(alert) {
  const { residual } = alert;
  const number = (value) => (value === null || value === undefined ? null : value.toPrecision(3));
  return facts([
    [F.deltaF, residual && number(residual.delta_f)], [F.threshold, residual && number(residual.threshold)], [F.p, residual && number(residual.p_value)],
    [F.edges, alert.edge_ids.join(", ")], [F.nodes, alert.node_ids.slice(0, 40).join(", ")], [F.views, String(alert.views)],
    [F.version, String(alert.map_version)], [F.revision, alert.decision_revision + " / " + alert.revision], [F.id, alert.id],
  ]);
}

function history(alert) {
  const items = alert.history.map((entry) => make("li", "", make("strong", "", STATUSES.get(entry.status)), " ", entry.by, " · ", time(entry.at),
    entry.reason ? make("p", "", REASONS.get(entry.reason)) : null, entry.note ? make("p", "note", entry.note) : null));
  return make("ol", "history", ...items);
}

class View {
  constructor(alert, open) {
    this.id = alert.id;
    this.open = open;
    this.title = make("h2");
    this.title.id = "panel-title";
    this.title.tabIndex = -1;
    this.sentence = make("p", "sentence");
    this.chips = make("p", "chips");
    this.note = make("textarea");
    Object.assign(this.note, { rows: 1, maxLength: 2000, placeholder: TEXTS.note });
    this.note.setAttribute("aria-label", TEXTS.note);
    this.actions = make("div", "row");
    this.buttons = new Map();
    this.evidence = new Evidence(alert);
    this.place = make("div");
    this.details = make("div");
    this.history = make("div");
    const fold = (title, content) => make("details", "", make("summary", "", title), content);
    const back = make("a", "back", TEXTS.back);
    back.href = "#/";
    byId("panel").replaceChildren(back, this.title, this.sentence, this.chips, this.note, this.actions, this.evidence.element, this.place, fold(TEXTS.details, this.details), make("h3", "", TEXTS.history), this.history);
  }

  /** Changes what differs; the note and the focus stay. */
  bring(alert) {
    say(this.title, alert.title ?? KINDS.get(alert.kind) ?? alert.kind);
    say(this.sentence, summary(alert));
    say(this.chips, [STATUSES.get(alert.status), DOUBTS.get(alert.tier), TEXTS.blocking[alert.blocking], alert.route_id].filter(Boolean).join(" · "));
    this.bringActions(alert);
    if (this.revision === alert.revision) return;
    this.revision = alert.revision;
    this.place.replaceChildren(place(alert));
    this.details.replaceChildren(details(alert));
    this.history.replaceChildren(history(alert));
    this.evidence.bring(alert);
  }

  bringActions(alert) {
    const shown = alert.actions.map((action) => {
      if (!this.buttons.has(action)) {
        const run = async () => {
          if (await decide(state.alerts.get(this.id), action, this.note.value.trim(), this.open)) this.note.value = "";
        };
        this.buttons.set(action, button(ACTIONS.get(action), run, action === "accept" ? "main" : ""));
      }
      const made = this.buttons.get(action);
      made.disabled = !isPossible(alert, action);
      return made;
    });
    arrange(this.actions, shown);
  }
}

/** What is half typed about the alert at hand. */
export const typedNote = () => view?.note.value.trim() ?? "";

/** Shows the chosen alert, or says that none is. */
export function showPanel(open) {
  const alert = state.alerts.get(state.chosen);
  if (!alert) {
    view = null;
    const text = state.chosen && state.live ? TEXTS.unknownAlert : TEXTS.noneChosen;
    const title = make("h2", "unseen", TEXTS.panel);
    title.id = "panel-title";
    if (byId("panel").textContent !== TEXTS.panel + text) byId("panel").replaceChildren(title, make("p", "quiet", text));
    return;
  }
  if (view?.id !== alert.id) view = new View(alert, open);
  view.bring(alert);
}
