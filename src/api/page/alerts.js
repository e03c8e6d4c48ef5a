// The list of alerts, their places on the map, and what is decided about them.

import { ACTIONS, DOUBTS, KINDS, STATUSES } from "/words.js";

const SVG = "http://www.w3.org/2000/svg";
const byId = (id) => document.getElementById(id);
// Alerts on the page by id: their item, and the revision and map version it shows.
const shown = new Map();
let chosen = null;

function element(name, className, text) {
  const made = document.createElement(name);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

// What is said of alerts that one pass alone shows so far.
const doubt = (alert) => (DOUBTS.get(alert.tier) ? " · " + DOUBTS.get(alert.tier) : "");
const words = (kind) => KINDS.get(kind) || kind;
const time = (stamp) => new Date(stamp).toLocaleString();
const plural = (count, word) => count + " " + word + (count === 1 ? "" : "s");

function facts(alert) {
  const { x, y, sigma } = alert.location;
  const parts = ["x " + x.toFixed(2) + " m, y " + y.toFixed(2) + " m ± " + sigma.toFixed(2) + " m", plural(alert.laps, "lap"),
    plural(alert.views, "view"), "confidence " + alert.confidence.toFixed(3), alert.vehicle_ids.join(", ")];
  const residual = alert.residual;
  if (residual && residual.ratio !== null) parts.push("ΔF " + residual.ratio.toPrecision(3) + " × the paper's threshold");
  return parts.filter(Boolean).join(" · ");
}

// What left one place and stands at another, as a door does: the kind and the middle of its region.
function otherSide({ kind, region }) {
  const middle = (k) => region.reduce((sum, corner) => sum + corner[k], 0) / Math.max(region.length, 1);
  return words(kind).toLowerCase() + " at x " + middle(0).toFixed(2) + " m, y " + middle(1).toFixed(2) + " m";
}

// The vector by which what was observed would have to be moved to lie on the map.
const heights = ({ from, to }) => from.toFixed(2) + " to " + to.toFixed(2) + " m";
const shiftBy = ({ x, y }) => "The map is off there: what was observed fits it when moved by x " + x.toFixed(2) + " m, y " + y.toFixed(2) + " m";

function history(alert) {
  const list = element("ul", "history");
  for (const entry of alert.history) {
    const note = entry.note === null ? "" : ": " + entry.note;
    list.append(element("li", "", time(entry.at) + " " + entry.status + " by " + entry.by + note));
  }
  return list;
}

async function decide(alert, action, note, refresh) {
  const by = byId("decider").value.trim();
  const body = { ...(note && { note }), ...(by && { by }) };
  const response = await fetch("/v1/alerts/" + alert.id + "/" + action, {
    method: "POST",
    headers: { "Content-Type": "application/json", "If-Match": '"' + alert.decision_revision + '"' },
    body: JSON.stringify(body),
  });
  if (response.ok) return refresh();
  const problem = await response.json();
  throw new Error(problem.title + ": " + problem.detail);
}

function form(alert, refresh) {
  const made = element("form");
  const note = element("input");
  note.maxLength = 2000;
  note.placeholder = "note";
  note.setAttribute("aria-label", "Note on the decision");
  const answer = element("p", "answer");
  answer.setAttribute("role", "status");
  made.append(note);
  for (const action of alert.actions) {
    const button = element("button", "", ACTIONS.get(action) || action);
    button.type = "button";
    button.addEventListener("click", async () => {
      const buttons = made.querySelectorAll("button");
      for (const other of buttons) other.disabled = true;
      answer.textContent = action === "accept" || action === "undo" ? "The map is being made anew …" : "";
      try {
        await decide(alert, action, note.value.trim(), refresh);
        answer.textContent = "";
      } catch (error) {
        answer.textContent = error.message;
      }
      for (const other of buttons) other.disabled = false;
    });
    made.append(button);
  }
  made.addEventListener("submit", (event) => event.preventDefault());
  return [made, answer];
}

function item(alert, refresh) {
  const made = element("li", "alert " + alert.status);
  made.id = "alert-" + alert.id;
  made.append(element("h4", "", words(alert.kind) + " · " + alert.status + doubt(alert)), element("p", "", facts(alert)));
  const until = alert.until === null ? "" : ", until " + time(alert.until);
  made.append(element("p", "", "seen " + time(alert.since) + " to " + time(alert.last_seen) + until + "; map version " + alert.map_version));
  if (alert.counterpart !== null) made.append(element("p", "", "Other side: " + otherSide(alert.counterpart)));
  for (const fault of alert.suspect?.faults ?? []) made.append(element("p", "", fault.text));
  if (alert.suspect?.silenced.length) made.append(element("p", "", plural(alert.suspect.silenced.length, "change") + " that this explains: no alert is raised"));
  if (alert.shift !== null) made.append(element("p", "", shiftBy(alert.shift)));
  if (alert.bands.length > 0) made.append(element("p", "", "Seen " + alert.bands.map(heights).join(" and ") + " above the floor"));
  const link = element("a");
  link.href = "/v1/alerts/" + alert.id + "/evidence.svg";
  link.target = "_blank";
  link.rel = "noopener";
  const picture = element("img");
  picture.loading = "lazy";
  picture.alt = "Both scans at the place and the residuals around its closure";
  // Another address for another revision: the picture is read anew when the alert has changed.
  picture.src = link.href + "#" + alert.revision;
  link.append(picture);
  made.append(link, ...form(alert, refresh), history(alert));
  return made;
}

// A choice of texts, each with its words.
export function offer(select, choices) {
  for (const [value, label] of choices) select.append(new Option(label, value));
}
offer(byId("alert-status"), STATUSES);

// Items that have not changed stay as they are, with the note that is being written in them.
export function showAlerts(page, refresh) {
  const list = byId("alerts");
  const items = page.items.map((alert) => {
    const known = shown.get(alert.id);
    if (known && known.revision === alert.revision) return known.item;
    const made = item(alert, refresh);
    shown.set(alert.id, { revision: alert.revision, item: made });
    return made;
  });
  const current = [...list.children];
  if (items.length !== current.length || items.some((made, k) => made !== current[k])) {
    const focused = document.activeElement;
    list.replaceChildren(...items);
    if (focused && list.contains(focused)) focused.focus();
  }
  const ids = new Set(page.items.map((alert) => alert.id));
  for (const id of shown.keys()) if (!ids.has(id)) shown.delete(id);
  byId("no-alerts").hidden = page.items.length > 0;
  byId("more-alerts").hidden = page.next_cursor === null;
}

function choose(alert) {
  for (const old of document.querySelectorAll(".chosen")) old.classList.remove("chosen");
  chosen = alert.id;
  for (const id of ["alert-", "region-"]) byId(id + alert.id)?.classList.add("chosen");
  byId("alert-" + alert.id)?.scrollIntoView({ behavior: "smooth", block: "nearest" });
}

function draw(parent, name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  parent.append(made);
  return made;
}

// The picture's pixels are the drawing's units; a ring keeps small regions visible.
export function showRegions(alerts, map, place) {
  const svg = byId("regions");
  svg.replaceChildren();
  if (!place || map.hidden || !map.naturalWidth) return;
  const [width, height] = [map.naturalWidth, map.naturalHeight];
  svg.setAttribute("viewBox", "0 0 " + width + " " + height);
  const at = (x, y) => [(x - place.x) / place.resolution, height - (y - place.y) / place.resolution];
  for (const alert of alerts) {
    const pending = alert.status === "open" || alert.status === "acknowledged";
    const names = [pending ? "" : "settled", alert.tier, alert.id === chosen ? "chosen" : ""].filter(Boolean).join(" ");
    const points = alert.region.map(([x, y]) => at(x, y).map((v) => v.toFixed(2)).join(","));
    const polygon = draw(svg, "polygon", { id: "region-" + alert.id, class: names, points: points.join(" ") });
    draw(polygon, "title", {}).textContent = words(alert.kind) + ", " + alert.status + doubt(alert);
    polygon.addEventListener("click", () => choose(alert));
    const [cx, cy] = at(alert.location.x, alert.location.y);
    draw(svg, "circle", { class: names, cx: cx.toFixed(2), cy: cy.toFixed(2), r: (0.02 * Math.max(width, height)).toFixed(2) });
  }
}
