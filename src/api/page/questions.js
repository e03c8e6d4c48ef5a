// What is asked before a decision: what accepting will change, why something is dismissed.

import { sentence } from "./alert_facts.js";
import { ask } from "./dialog.js";
import { choice, facts, make, noteField } from "./dom.js";
import { alertPath, get } from "./http.js";
import { TEXTS } from "./texts.js";
import { ACTIONS, REASONS } from "./words.js";

/**
 * @typedef {import("./types").Alert} Alert
 * @typedef {{note?: string, reason?: string, muteHours?: number, revision?: number}} Said
 */

const P = TEXTS.preview;

/** @param {import("./types").Preview} preview */
function previewFacts(preview) {
  const { to_occupied, to_free, to_unknown, from_unknown } = preview.cells;
  return facts([
    [P.version, String(preview.map_version_next)],
    [P.cells, P.cellCounts(to_occupied, to_free, to_unknown, from_unknown)],
    [P.edges, String(preview.edges_retired)],
    [P.nodes, String(preview.nodes_handed_over)],
    [P.moved, P.atMost(preview.max_displacement_m)],
    [P.precision, preview.nodes_reactivated ? P.approximate(preview.nodes_reactivated) : null],
  ]);
}

/**
 * Shows what accepting would change before it can be confirmed.
 * @param {Alert} alert
 * @param {string} note
 * @returns {Promise<Said | null>}
 */
export async function askBeforeAccepting(alert, note) {
  const effect = make("div", "preview", make("p", "quiet", P.working));
  effect.setAttribute("role", "status");
  const { area, field } = noteField(TEXTS.note, note);
  const accept = ACTIONS.get("accept") ?? "";
  const answered = ask(TEXTS.acceptTitle, [make("p", "", sentence(alert)), effect, field], [[TEXTS.cancel, null], [accept, true, "main"]]);
  /** @type {number | undefined} what was previewed is what is decided about */
  let revision;
  const confirm = document.querySelector("dialog[open] button.main");
  if (confirm instanceof HTMLButtonElement) {
    confirm.disabled = true;
    get(alertPath(alert.id) + "/preview").then(
      (preview) => {
        revision = preview.decision_revision;
        effect.replaceChildren(previewFacts(preview), make("p", "quiet", TEXTS.acceptBody));
        confirm.disabled = false;
        if (document.activeElement !== area) confirm.focus();
      },
      (error) => {
        effect.replaceChildren(make("p", "refusal", error.message));
        // Without a preview one may still decide; what cannot be accepted stays locked.
        confirm.disabled = error.status === 409;
      },
    );
  }
  return (await answered) ? { note: area.value.trim(), revision } : null;
}

/**
 * @param {number} count
 * @returns {Promise<Said | null>}
 */
export async function askBeforeAcceptingSeveral(count) {
  const { area, field } = noteField(TEXTS.note, "");
  const answer = await ask(TEXTS.acceptSeveralTitle(count), [make("p", "", TEXTS.acceptSeveralBody), field], [[TEXTS.cancel, null], [ACTIONS.get("accept") ?? "", true, "main"]]);
  return answer ? { note: area.value.trim() } : null;
}

/**
 * Asks for the reason, and whether the place is muted for a time.
 * @param {string} note
 * @param {Alert | null} alert null for several, which have no one place
 * @returns {Promise<Said | null>}
 */
export async function askBeforeDismissing(note, alert) {
  const set = make("fieldset", "", make("legend", "unseen", TEXTS.reason));
  REASONS.forEach((label, value) => {
    const radio = make("input");
    Object.assign(radio, { type: "radio", name: "reason", value, checked: value === "temporary" });
    set.append(make("label", "radio", radio, label));
  });
  const { area, field } = noteField(TEXTS.note, note);
  const hours = choice(TEXTS.mute, TEXTS.muteHours, () => {});
  const muting = alert && alert.region.length > 2 ? make("label", "field", TEXTS.mute, hours) : null;
  const content = [make("p", "", TEXTS.dismissBody), set, ...(muting ? [muting] : []), field];
  const answer = await ask(TEXTS.dismissTitle, content, [[TEXTS.cancel, null], [ACTIONS.get("dismiss") ?? "", true, "main"]]);
  const chosen = set.querySelector("input:checked");
  if (!answer || !(chosen instanceof HTMLInputElement)) return null;
  return { note: area.value.trim(), reason: chosen.value, muteHours: Number(hours.value) };
}
