// Who takes care of an alert, and what was said about it.

import { toastError } from "./dialog.js";
import { button, make } from "./dom.js";
import { time } from "./format.js";
import { alertPath, getIfThere, send } from "./http.js";
import { ownName, typedName } from "./sign_in.js";
import { draft, keep, keepDraft, may, state } from "./state.js";
import { TEXTS } from "./texts.js";

/** @typedef {import("./types").Alert} Alert */

const SHOWN_MAX = 200;

export class Discussion {
  /** @param {Alert} alert */
  constructor(alert) {
    this.path = alertPath(alert.id);
    this.draft = "comment " + alert.id;
    this.assignee = make("p", "assignee");
    this.comments = make("ol", "history");
    this.text = make("textarea");
    Object.assign(this.text, { rows: 2, maxLength: 2000, value: draft(this.draft), placeholder: TEXTS.comment });
    this.text.setAttribute("aria-label", TEXTS.comment);
    this.text.addEventListener("input", () => keepDraft(this.draft, this.text.value));
    const post = button(TEXTS.postComment, () => { this.post().catch(toastError); });
    const isMaintainer = may("maintainer");
    this.element = make("section", "discussion", this.assignee, this.comments, isMaintainer ? this.text : null, isMaintainer ? post : null);
    this.element.setAttribute("aria-label", TEXTS.comments);
    this.element.hidden = true;
    this.count = -1;
    this.id = alert.id;
  }

  /** @param {Alert} alert */
  bring(alert) {
    // A service that cannot assign says nothing about it.
    this.element.hidden = alert.assignee === undefined;
    if (this.element.hidden) return;
    const [take, drop] = [button(TEXTS.takeIt, () => this.assign(ownName() || TEXTS.somebody)), button(TEXTS.giveBack, () => this.assign(null))];
    const key = String(alert.assignee);
    if (this.assignee.dataset.key !== key) {
      this.assignee.dataset.key = key;
      this.assignee.replaceChildren(alert.assignee ? TEXTS.assignedTo(alert.assignee) + " " : TEXTS.unassigned + " ", ...(may("maintainer") ? [alert.assignee ? drop : take] : []));
    }
    if (this.count === alert.comments) return;
    this.count = alert.comments ?? 0;
    this.read().catch(toastError);
  }

  /** @param {string | null} assignee */
  assign(assignee) {
    send("PUT", this.path + "/assignee", { assignee }).then((answer) => { if (answer.id) keep(answer); }, toastError);
  }

  async read() {
    const page = await getIfThere(this.path + "/comments?limit=" + SHOWN_MAX);
    const items = /** @type {import("./types").Comment[]} */ (page?.items ?? []);
    this.comments.replaceChildren(...items.map((comment) => make("li", "", make("strong", "", comment.by), " · ", time(comment.at), make("p", "note", comment.text))));
  }

  async post() {
    const text = this.text.value.trim();
    if (!text) { this.text.focus(); return; }
    const by = typedName();
    await send("POST", this.path + "/comments", { text, ...(by && { by }) });
    this.text.value = "";
    keepDraft(this.draft, "");
    this.count = -1;
    const alert = state.alerts.get(this.id);
    if (alert) this.bring(alert);
  }
}
