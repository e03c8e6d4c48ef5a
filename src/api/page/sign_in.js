// Who is signed in, and how one signs in and out.

import { button, byId, make, say } from "./dom.js";
import { getIfThere, send, SESSION } from "./http.js";
import { state } from "./state.js";
import { TEXTS } from "./texts.js";

const NAME = "by";

/** Reads who is signed in; a service without sessions is open to everybody. */
export async function readSession() {
  const session = await getIfThere(SESSION);
  if (session) state.session = session.open ? { ...session, role: "admin" } : session;
}

/** The name for a decision where nobody signs in. */
export const typedName = () => (state.session.open ? localStorage.getItem(NAME)?.trim() ?? "" : "");
/** Who decides here. */
export const ownName = () => (state.session.open ? typedName() : state.session.name ?? "");

/** @param {() => void} beforeSigningOut */
export function showAccess(beforeSigningOut) {
  const { open, name, role } = state.session;
  byId("who").hidden = !open;
  if (open) {
    say(byId("access"), TEXTS.open);
    const field = make("input");
    Object.assign(field, { maxLength: 100, autocomplete: "name", value: typedName() });
    field.addEventListener("input", () => localStorage.setItem(NAME, field.value));
    byId("who").replaceChildren(TEXTS.by + " ", field);
    return;
  }
  const out = button(TEXTS.signOut, async () => {
    beforeSigningOut();
    await send("DELETE", SESSION);
    location.reload();
  });
  byId("access").replaceChildren(TEXTS.role(name ?? "", role ?? ""), " ", out);
}

/** Asks for a key in place of the console. */
export function showSignIn() {
  if (!byId("sign-in").hidden) return;
  for (const id of ["console", "report", "banner"]) byId(id).hidden = true;
  const field = make("input");
  Object.assign(field, { type: "password", autocomplete: "current-password", required: true, id: "key" });
  const refusal = make("p", "refusal");
  refusal.setAttribute("role", "alert");
  const submit = make("button", "main", TEXTS.signIn);
  const form = make("form", "", make("h2", "", TEXTS.signIn), make("p", "quiet", TEXTS.signInHint), make("label", "field", TEXTS.key, field), submit, refusal);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    submit.disabled = true;
    try {
      await send("POST", SESSION, { key: field.value.trim() });
      location.reload();
    } catch (error) {
      say(refusal, error instanceof Error ? error.message : String(error));
      submit.disabled = false;
    }
  });
  byId("sign-in").replaceChildren(form);
  byId("sign-in").hidden = false;
  field.focus();
}
