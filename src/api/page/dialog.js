// Questions that have to be answered before something is done, and short messages afterwards.

import { button, byId, make } from "./dom.js";
import { TEXTS } from "./texts.js";

const TOAST_MS = 20000;

/**
 * A dialog that answers with what its button stands for, or null when it is closed.
 * @template T
 * @param {string} title
 * @param {Node[]} content
 * @param {[string, T | null, string?][]} buttons
 * @returns {Promise<T | null>}
 */
export function ask(title, content, buttons) {
  return new Promise((resolve) => {
    const dialog = make("dialog");
    const heading = make("h2", "", title);
    heading.id = "dialog-title";
    dialog.setAttribute("aria-labelledby", heading.id);
    const row = make("div", "row");
    /** @type {T | null} */
    let answer = null;
    for (const [text, value, className] of buttons) row.append(button(text, () => { answer = value; dialog.close(); }, className));
    dialog.append(heading, ...content, row);
    dialog.addEventListener("close", () => { dialog.remove(); resolve(answer); });
    document.body.append(dialog);
    dialog.showModal();
    const last = row.lastElementChild;
    if (last instanceof HTMLElement) last.focus();
  });
}

/**
 * A message that goes away by itself, with a way back if there is one.
 * @param {string} text
 * @param {() => void} [undo]
 * @returns {() => void} takes it away at once
 */
export function toast(text, undo) {
  const made = make("p", "toast", make("span", "", text));
  const away = () => made.remove();
  if (undo) made.append(button(TEXTS.undo, () => { away(); undo(); }));
  byId("toasts").append(made);
  setTimeout(away, TOAST_MS);
  return away;
}

/**
 * A message with a progress bar, until it is taken away.
 * @param {string} text
 */
export function progress(text) {
  const bar = make("progress");
  bar.setAttribute("aria-label", text);
  const made = make("p", "toast", make("span", "", text), bar);
  byId("toasts").append(made);
  return {
    /** @param {number} share of 1 */
    set: (share) => { bar.value = share; },
    end: () => made.remove(),
  };
}

/** @param {unknown} error */
export const toastError = (error) => { toast(error instanceof Error ? error.message : String(error)); };
