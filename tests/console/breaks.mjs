// What a break of the line costs: the service is cut off while alerts change, again and again. Measures how
// soon a change is on its card without a break, and counts what is missed or twice after one.
// Usage: node breaks.mjs MAPSHIFT [BREAKS]

import fs from "node:fs";
import { findChromium, launch, openPage } from "./browser.mjs";
import { Relay } from "./relay.mjs";
import { demonstrate, serve } from "./service.mjs";

const [program, breaksText = "100"] = process.argv.slice(2);
const chromium = findChromium();
if (!program || !chromium) {
  console.log(program ? "SKIPPED: there is no Chromium" : "Usage: node breaks.mjs MAPSHIFT [BREAKS]");
  process.exit(program ? 0 : 2);
}

const data = await demonstrate(program);
const service = await serve(program, data);
const relay = new Relay(service.port);
const base = await relay.listen();
const direct = "http://127.0.0.1:" + service.port;
const browser = await launch(chromium);
const { page } = await openPage(browser, base);

/** Takes an alert up, or puts it back, past the relay; the alert as it is then. */
async function change(id) {
  const alert = await (await fetch(direct + "/v1/alerts/" + id)).json();
  const action = alert.status === "open" ? "acknowledge" : "reopen";
  const headers = { "Content-Type": "application/json", "If-Match": '"' + alert.decision_revision + '"' };
  const response = await fetch(direct + "/v1/alerts/" + id + "/" + action, { method: "POST", headers, body: "{}" });
  if (!response.ok) throw new Error(await response.text());
  return response.json();
}

/** Waits until the card of an alert says its status; milliseconds. */
async function seen(alert) {
  const begun = performance.now();
  const shows = ({ id, status }) => document.querySelector('a[href="#/alerts/' + id + '"]')?.textContent?.includes(status) ?? false;
  await page.waitForFunction(shows, { id: alert.id, status: alert.status }, { polling: 5 });
  return performance.now() - begun;
}

/** What is on the page otherwise than the service has it. */
async function wrong() {
  const { items } = await (await fetch(direct + "/v1/alerts?limit=1000")).json();
  const cards = await page.$$eval('#inbox a[href^="#/alerts/"]', (links) => links.map((link) => [link.getAttribute("href"), link.textContent]));
  const waiting = items.filter((alert) => alert.status === "open" || alert.status === "acknowledged");
  const missed = waiting.filter((alert) => !cards.some(([href, text]) => href === "#/alerts/" + alert.id && text.includes(alert.status)));
  return { missed: missed.length, twice: cards.length - new Set(cards.map(([href]) => href)).size };
}

const middle = (values) => [...values].sort((a, b) => a - b)[values.length >> 1].toFixed(0);
await page.goto(base);
await page.waitForSelector('#inbox a[href^="#/alerts/"]');
const ids = (await (await fetch(direct + "/v1/alerts?status=open")).json()).items.map((alert) => alert.id);
const direct_ms = [];
for (let k = 0; k < 20; k++) direct_ms.push(await seen(await change(ids[k % ids.length])));
console.log("from the answer to a decision to its card: median " + middle(direct_ms) + " ms, most " + Math.max(...direct_ms).toFixed(0) + " ms, of " + direct_ms.length);
const [after_ms, faults] = [[], { missed: 0, twice: 0 }];
for (let k = 0; k < Number(breaksText); k++) {
  relay.cut();
  const changed = [await change(ids[k % ids.length]), await change(ids[(k + 1) % ids.length])];
  relay.mend();
  const begun = performance.now();
  for (const alert of changed) await seen(alert);
  after_ms.push(performance.now() - begun);
  const { missed, twice } = await wrong();
  faults.missed += missed;
  faults.twice += twice;
}
console.log(after_ms.length + " breaks: " + faults.missed + " missed, " + faults.twice + " twice; the cards are right again after " + middle(after_ms) + " ms (median), " + Math.max(...after_ms).toFixed(0) + " ms (most)");
await browser.close();
relay.close();
await service.stop();
fs.rmSync(data, { recursive: true });
process.exit(faults.missed + faults.twice === 0 ? 0 : 1);
