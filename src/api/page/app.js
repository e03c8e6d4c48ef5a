// Where the page begins: signing in, the address, the keys, and who is told of changes.

import { ask, button, byId, facts, make, say } from "/dom.js";
import { decide } from "/decide.js";
import { getIfThere, list, send } from "/http.js";
import { showInbox } from "/inbox.js";
import { follow, unfollow } from "/live.js";
import { readMap, showPlace } from "/map.js";
import { showPanel, typedNote } from "/panel.js";
import { showRoute } from "/route.js";
import { changed, listen, shownAlerts, state } from "/state.js";
import { TEXTS } from "/texts.js";

const ROUTES_EVERY_MS = 15000;

const open = (id) => { location.hash = "#/alerts/" + id; };
const choose = (route, tab) => { location.hash = "#/routes/" + encodeURIComponent(route) + "/" + tab; };

/** Brings the state up to the address. */
function followAddress() {
  const [kind, name, tab] = location.hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
  document.body.dataset.at = kind === "alerts" && name ? "alert" : kind === "routes" ? "route" : "inbox";
  if (kind === "alerts") state.chosen = name;
  if (kind === "routes" && name) {
    state.route = name;
    state.tab = tab in TEXTS.tabs ? tab : "map";
  }
  if (!kind) state.chosen = null;
  placed = null;
  changed();
}

/** The alert whose place the map shows. */
let placed = null;

function showChosenPlace() {
  const alert = state.alerts.get(state.chosen);
  if (!alert || placed === alert.id || document.body.dataset.at !== "alert") return;
  placed = alert.id;
  state.route = alert.route_id;
  state.tab = "map";
  showPlace(alert.location);
}

function showState() {
  const { live, session } = state;
  say(byId("connection"), live ? TEXTS.live : TEXTS.connecting);
  byId("connection").className = live ? "live" : "lost";
  byId("banner").hidden = live || !everLive;
  everLive ||= live;
  if (session.open) say(byId("access"), TEXTS.open);
  byId("who").hidden = !session.open;
}
let everLive = false;
/** Statuses by alert: when one changes, the accepted map may. */
let statuses = "";

function show() {
  showChosenPlace();
  showState();
  showInbox(open);
  showRoute(choose, open);
  showPanel(open);
  const now = [...state.alerts.values()].map((alert) => alert.id + alert.status).join();
  if (now !== statuses) {
    statuses = now;
    readMap().catch(() => {});
  }
}

async function readRoutes() {
  if (document.hidden) return;
  state.routes = await list("/v1/routes", 1000);
  state.route ??= state.routes[0]?.id ?? null;
  changed();
}

function step(by) {
  const shown = shownAlerts();
  const place = shown.findIndex((alert) => alert.id === state.chosen);
  const next = shown[Math.min(Math.max(place + by, 0), shown.length - 1)];
  if (next) {
    open(next.id);
    document.querySelector('a[href="#/alerts/' + next.id + '"]')?.scrollIntoView({ block: "nearest" });
  }
}

const act = (action) => {
  const alert = state.alerts.get(state.chosen);
  if (alert) decide(alert, action, typedNote(), open);
};

const KEYS = {
  j: () => step(1), k: () => step(-1), a: () => act("accept"), d: () => act("dismiss"), e: () => act("acknowledge"), u: () => act("undo"),
  "/": () => byId("search").focus(), "?": () => ask(TEXTS.help, [facts(TEXTS.helpRows)], [[TEXTS.close, null]]),
};

function hearKeys(event) {
  const isTyping = event.target instanceof Element && event.target.closest("input:not([type=checkbox]), textarea, select, dialog");
  if (event.key === "Escape" && isTyping && !event.target.closest("dialog")) event.target.blur();
  if (isTyping || event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
}

function showSignIn() {
  const field = make("input");
  Object.assign(field, { type: "password", autocomplete: "current-password", required: true, id: "key" });
  const [hint, refusal] = [make("p", "quiet", TEXTS.signInHint), make("p", "refusal")];
  refusal.setAttribute("role", "alert");
  const submit = make("button", "main", TEXTS.signIn);
  const form = make("form", "", make("h2", "", TEXTS.signIn), hint, make("label", "field", TEXTS.key, field), submit, refusal);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      await send("POST", "/v1/session", { key: field.value });
      location.reload();
    } catch (error) {
      say(refusal, error.message);
    }
  });
  byId("sign-in").replaceChildren(form);
  byId("sign-in").hidden = false;
  field.focus();
}

async function readSession() {
  const session = await getIfThere("/v1/session");
  if (session) state.session = session.open ? { ...session, role: "admin" } : session;
  if (session && !session.open && session.role) {
    const out = button(TEXTS.signOut, async () => { unfollow(); await send("DELETE", "/v1/session"); location.reload(); });
    byId("access").replaceChildren(TEXTS.role(session.name, session.role) + " ", out);
  }
}

function prepare() {
  say(byId("who-label"), TEXTS.by);
  const by = byId("by");
  by.value = localStorage.getItem("by") ?? "";
  by.addEventListener("input", () => localStorage.setItem("by", by.value));
  for (const [text, href] of TEXTS.links) byId("links").append(Object.assign(make("a", "", text), { href }));
  byId("links").append(button(TEXTS.help, KEYS["?"]));
  say(byId("banner"), TEXTS.lost);
}

async function begin() {
  prepare();
  await readSession();
  if (!state.session.open && !state.session.role) { showSignIn(); return; }
  byId("console").hidden = false;
  addEventListener("hashchange", followAddress);
  document.addEventListener("keydown", hearKeys);
  listen(show);
  followAddress();
  const routes = () => readRoutes().catch(() => {});
  setInterval(routes, ROUTES_EVERY_MS);
  setInterval(changed, 60000);
  await routes();
  follow();
}

begin().catch((error) => {
  say(byId("banner"), error.message);
  byId("banner").hidden = false;
});
