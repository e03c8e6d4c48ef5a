// How a route is watched, and its muted zones.

import { toast, toastError } from "./dialog.js";
import { facts, make } from "./dom.js";
import { getTagged, routePath, send } from "./http.js";
import { may } from "./state.js";
import { TEXTS } from "./texts.js";
import { zoneTable } from "./zones.js";

const T = TEXTS.settings;

/**
 * @param {string} label
 * @param {string} value
 * @param {Partial<HTMLInputElement>} kind
 */
function field(label, value, kind) {
  const input = make("input");
  Object.assign(input, kind, { value, disabled: !may("maintainer") });
  return { input, element: make("label", "field", label, input) };
}

/**
 * @param {string} route
 * @param {() => void} again
 */
export async function settings(route, again) {
  const { body, tag } = await getTagged(routePath(route));
  const known = /** @type {import("./types").Route} */ (body);
  const name = field(T.name, known.display_name ?? "", { maxLength: 200 });
  const rate = field(T.rate, String(known.settings.false_alarm_rate), { type: "number", min: "0.0001", max: "1", step: "any", required: true });
  const hold = field(T.hold, String(known.settings.hold_s), { type: "number", min: "0", step: "1", required: true });
  const shift = field(T.shift, String(known.settings.max_shift_m), { type: "number", min: "0", step: "any", required: true });
  const save = make("button", "main", T.save);
  save.disabled = !may("maintainer");
  const form = make("form", "settings", name.element, rate.element, hold.element, shift.element, save);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const put = {
      ...(name.input.value.trim() && { display_name: name.input.value.trim() }),
      settings: { false_alarm_rate: Number(rate.input.value), hold_s: Number(hold.input.value), max_shift_m: Number(shift.input.value) },
    };
    send("PUT", routePath(route), put, tag ? { "If-Match": tag } : {}).then(() => { toast(T.saved); again(); }, toastError);
  });
  const fixed = facts([[T.stage, known.stage], [T.detector, known.settings.detector], [T.waiting, String(known.pending_batches)], ...Object.entries(known.counts).map(([what, count]) => /** @type {[string, string]} */ ([T.counts[what] ?? what, String(count)]))]);
  return make("div", "columns", form, fixed, await zoneTable(route, again));
}
