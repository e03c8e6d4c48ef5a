// Where the page begins: who is signed in, the address, and who shows what when something changes.

import { readAddress, readPlace, routeAddress } from "./address.js";
import { button, byId, link, mark, say } from "./dom.js";
import { list, whenSignedOut } from "./http.js";
import { showInbox } from "./inbox.js";
import { hearKeys, showHelp } from "./keys.js";
import { follow, unfollow } from "./live.js";
import { readMap, showPlace } from "./map.js";
import { showPanel } from "./panel.js";
import { forgetReport, showReport } from "./report.js";
import { showRoute } from "./route.js";
import { readSession, showAccess, showSignIn } from "./sign_in.js";
import { changed, chosenAlert, listen, state } from "./state.js";
import { TEXTS } from "./texts.js";

const ROUTES_EVERY_MS = 15000;
const AGES_EVERY_MS = 60000;

let address = readAddress(location.hash);
/** @type {string | null} the alert whose place the map shows */
let placed = null;
let wasLive = false;
/** Statuses by alert: when one changes, the accepted map may. */
let statuses = "";

/** Brings the state up to the address. */
function followAddress() {
  address = readAddress(location.hash);
  document.body.dataset.at = address.at;
  if (address.at === "alert") state.chosen = address.name;
  if (address.at === "inbox") state.chosen = null;
  if (address.at === "route") {
    state.route = address.name;
    state.tab = address.tab in TEXTS.tabs ? address.tab : "map";
    const place = readPlace(address.query);
    if (place && state.tab === "map") showPlace(place, place.z);
  }
  if (address.at !== "report") forgetReport();
  placed = null;
  changed();
}

/** The map goes to the alert that was opened. */
function showChosenPlace() {
  const alert = chosenAlert();
  if (!alert || placed === alert.id || address.at !== "alert") return;
  placed = alert.id;
  state.route = alert.route_id;
  state.tab = "map";
  showPlace(alert.location);
}

function showConnection() {
  const { live } = state;
  say(byId("connection"), live ? TEXTS.live : wasLive ? TEXTS.broken : TEXTS.connecting);
  byId("connection").className = live ? "live" : "lost";
  byId("banner").hidden = live || !wasLive;
  wasLive ||= live;
  const at = { inbox: address.at === "inbox" || address.at === "alert", route: address.at === "route", report: address.at === "report" };
  for (const [name, isHere] of Object.entries(at)) mark(byId("to-" + name), "aria-current", isHere ? "page" : null);
  mark(byId("to-route"), "href", routeAddress(state.route ?? "", state.tab));
}

function show() {
  if (!byId("sign-in").hidden) return;
  const isReport = address.at === "report";
  byId("report").hidden = !isReport;
  byId("console").hidden = isReport;
  showConnection();
  if (isReport) { showReport(address.query); return; }
  showChosenPlace();
  showInbox();
  showRoute();
  showPanel();
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

function prepare() {
  const places = [["inbox", "#/"], ["route", "#/"], ["report", "#/report"]].map(([name, href]) => Object.assign(link(TEXTS.places[name], href, "tab"), { id: "to-" + name }));
  byId("places").append(...places);
  byId("places").setAttribute("aria-label", TEXTS.placesLabel);
  byId("links").append(link(TEXTS.api, "/docs/"), button(TEXTS.help, showHelp));
  say(byId("banner"), TEXTS.lost);
  // A tab that was in the background shows how things are now.
  document.addEventListener("visibilitychange", () => { if (!document.hidden) { readRoutes().catch(() => {}); readMap().catch(() => {}); } });
}

async function begin() {
  prepare();
  await readSession();
  const signOut = () => { unfollow(); showSignIn(); };
  whenSignedOut(signOut);
  if (!state.session.open && !state.session.role) { showSignIn(); return; }
  showAccess(unfollow);
  addEventListener("hashchange", followAddress);
  hearKeys();
  listen(show);
  followAddress();
  setInterval(() => { readRoutes().catch(() => {}); }, ROUTES_EVERY_MS);
  setInterval(changed, AGES_EVERY_MS);
  follow();
  await readRoutes();
}

begin().catch((error) => {
  say(byId("banner"), error.message);
  byId("banner").hidden = false;
});
