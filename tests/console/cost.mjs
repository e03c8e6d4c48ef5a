// What the console costs: bytes and time of the first view, bytes of an idle tab, frames while the map is dragged.
// Usage: node cost.mjs URL ROUTE [IDLE_S]; big_route.mjs makes a route to try it on.

import { findChromium, launch, openPage } from "./browser.mjs";

const DRAGS = 180;
const [url, route, idleS = "60"] = process.argv.slice(2);
const chromium = findChromium();
if (!route || !chromium) {
  console.log(route ? "SKIPPED: there is no Chromium" : "Usage: node cost.mjs URL ROUTE [IDLE_S]");
  process.exit(route ? 0 : 2);
}
const browser = await launch(chromium);
const { page, faults } = await openPage(browser, url);
const cdp = await page.context().newCDPSession(page);
await cdp.send("Network.enable");
let bytes = 0;
cdp.on("Network.dataReceived", (event) => { bytes += event.encodedDataLength; });
cdp.on("Network.responseReceived", (event) => { bytes += event.response.encodedDataLength; });
cdp.on("Network.eventSourceMessageReceived", (event) => { bytes += event.data.length; });

/** Whether the canvas shows more than its ground and its scale. */
function isDrawn() {
  const canvas = document.querySelector("canvas");
  if (!canvas?.width) return false;
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const colours = new Set();
  for (let k = 0; k < data.length; k += 4 * 97) colours.add([data[k], data[k + 1], data[k + 2]].join());
  return colours.size >= 3;
}

async function firstView() {
  const begun = performance.now();
  await page.goto(url + "/#/routes/" + route + "/map", { waitUntil: "commit" });
  await page.waitForFunction(isDrawn, null, { timeout: 60000, polling: 20 });
  const tookMs = performance.now() - begun;
  await page.waitForTimeout(3000);
  console.log("first view: the map after " + tookMs.toFixed(0) + " ms, " + bytes + " bytes after 3 s more");
}

async function idle() {
  const before = bytes;
  await page.waitForTimeout(Number(idleS) * 1000);
  console.log("idle: " + ((bytes - before) / Number(idleS)).toFixed(0) + " bytes/s over " + idleS + " s");
}

/** Drags the map to and fro, and says how long its frames took. */
async function drag(where) {
  const box = await page.locator("canvas").first().boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  await page.evaluate(() => {
    const times = [];
    globalThis.times = times;
    // Ends when the next drag begins.
    const note = (time) => { times.push(time); if (globalThis.times === times) requestAnimationFrame(note); };
    requestAnimationFrame(note);
  });
  await page.mouse.move(x, y);
  await page.mouse.down();
  for (let k = 0; k < DRAGS; k++) {
    await page.mouse.move(x + 200 * Math.sin(k / 12), y + 100 * Math.sin(k / 7));
    await page.waitForTimeout(8);
  }
  await page.mouse.up();
  const times = await page.evaluate(() => globalThis.times);
  const gaps = times.slice(1).map((time, k) => time - times[k]).sort((a, b) => a - b);
  const rate = (1000 * gaps.length) / (times.at(-1) - times[0]);
  console.log("dragged " + where + ": " + rate.toFixed(1) + " frames/s, median " + gaps[gaps.length >> 1].toFixed(1) + " ms, 95 % " + gaps[Math.floor(0.95 * gaps.length)].toFixed(1) + " ms, worst " + gaps.at(-1).toFixed(1) + " ms");
}

async function zoomIn() {
  const box = await page.locator("canvas").first().boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  for (let k = 0; k < 6; k++) {
    await page.mouse.wheel(0, -240);
    await page.waitForTimeout(60);
  }
  await page.waitForTimeout(1500);
}

await firstView();
await idle();
await drag("all of it");
await zoomIn();
await drag("nearer");
await zoomIn();
await drag("near");
console.log(faults.length === 0 ? "no faults" : faults.join("\n"));
await browser.close();
