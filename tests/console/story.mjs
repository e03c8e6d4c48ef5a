// Walks the maintainers' console as a maintainer would: node story.mjs path/to/mapshift

import fs from "node:fs";
import { createRequire } from "node:module";
import { findChromium, launch, openPage } from "./browser.mjs";
import { check, equal, holds, sum, until } from "./checks.mjs";
import { decidingStory } from "./deciding.mjs";
import { Relay } from "./relay.mjs";
import { demonstrate, makeKey, serve } from "./service.mjs";

const FIRST_VIEW_MAX = 300_000;
const IDLE_MAX_PER_S = 5_000;
const TABS = ["vehicles", "batches", "residuals", "versions", "settings", "audit"];
const AXE = fs.readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

const chromium = findChromium();
if (!chromium) {
  console.log("SKIPPED: no Chromium (set CHROMIUM to the path of one)");
  process.exit(0);
}
const program = process.argv[2];
const data = await demonstrate(program);
const service = await serve(program, data);
const relay = new Relay(service.port);
const base = await relay.listen();
const browser = await launch(chromium);
const api = async (path) => (await fetch("http://127.0.0.1:" + service.port + path)).json();

const isLive = (page) => page.waitForSelector("#connection.live");

async function axe(page, where) {
  await page.evaluate(AXE);
  const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  const found = violations.map(({ id, nodes }) => id + ": " + nodes.map((node) => node.html.slice(0, 120) + " " + (node.any[0]?.message ?? "")).join(" | "));
  equal(found.join("\n"), "", "what axe finds in " + where);
}

/** Nothing is cut off, and whatever can be pressed is large enough for a finger. */
async function fitsPhone(page, where) {
  const found = await page.evaluate(() => {
    const wide = document.documentElement.scrollWidth > innerWidth ? ["the page is " + document.documentElement.scrollWidth + " px wide"] : [];
    const pressed = [...document.querySelectorAll("button, select, summary, input:not([type=checkbox], [type=radio]), .tab, .card a")];
    const small = pressed.filter((element) => element.checkVisibility()).filter((element) => element.getBoundingClientRect().height < 43.5);
    return [...wide, ...small.map((element) => element.tagName + " " + element.textContent.slice(0, 30))];
  });
  equal(found.join("; "), "", "what does not fit a phone in " + where);
}

async function opening() {
  const { page, faults } = await openPage(browser, base);
  const before = relay.bytes;
  await page.goto(base + "/");
  await isLive(page);
  await page.waitForSelector(".card");
  await page.waitForLoadState("networkidle").catch(() => {});
  await check("the first view takes at most 300 kB", () => holds(relay.bytes - before <= FIRST_VIEW_MAX, relay.bytes - before + " bytes"));
  await check("the inbox has every alert that waits, numbered", async () => {
    const open = (await api("/v1/alerts?status=open")).items.length;
    const numbers = await page.locator(".card .number").allTextContents();
    equal(numbers.join(), Array.from({ length: open }, (_, k) => k + 1).join(), "the numbers");
  });
  await check("an idle tab is quiet", async () => {
    const start = relay.bytes;
    await page.waitForTimeout(4000);
    holds(relay.bytes - start <= 4 * IDLE_MAX_PER_S, relay.bytes - start + " bytes in 4 s");
  });
  return { page, faults };
}

async function map(page) {
  const canvas = page.locator(".map canvas");
  await check("the map has a picture", async () => {
    await until(() => canvas.evaluate((element) => {
      const { data } = element.getContext("2d").getImageData(0, 0, element.width, element.height);
      const seen = new Set();
      for (let k = 0; k < data.length; k += 4 * 97) seen.add(data[k] * 65536 + data[k + 1] * 256 + data[k + 2]);
      return seen.size > 3;
    }), "tiles");
  });
  await check("an address leads to a place, and follows the map", async () => {
    const [route] = (await api("/v1/routes")).items;
    await page.goto(base + "/#/routes/" + route.id + "/map?x=5.00&y=6.00&z=8.00");
    await canvas.focus();
    await page.keyboard.press("+");
    await until(() => page.evaluate(() => /x=5\.00&y=6\.00&z=8\.38/.test(location.hash)), "the address");
  });
}

async function otherViews(page) {
  const [route] = (await api("/v1/routes")).items;
  for (const tab of TABS) {
    await check("the tab " + tab + " has content that axe accepts", async () => {
      await page.goto(base + "/#/routes/" + route.id + "/" + tab);
      await page.waitForSelector(".content :is(table, svg, .version, form)");
      await axe(page, tab);
    });
  }
  await check("the shift report prints on one page", async () => {
    await page.goto(base + "/#/report");
    await page.waitForSelector(".report .counts li");
    await axe(page, "the report");
    const pdf = await page.pdf({ format: "A4" });
    equal((pdf.toString("latin1").match(/\/Type\s*\/Page\b(?!s)/g) ?? []).length, 1, "the number of pages");
  });
}

async function connectionLost(page) {
  const [alert] = (await api("/v1/alerts?status=open")).items;
  await page.goto(base + "/#/alerts/" + alert.id);
  await page.waitForSelector(".actions button:not(:disabled)");
  await check("without the service a banner says so and decisions are locked", async () => {
    relay.cut();
    await page.waitForSelector("#banner:not([hidden])");
    equal(await page.locator(".actions button:not(:disabled)").count(), 0, "the number of unlocked buttons");
  });
  await check("back again it shows what happened meanwhile", async () => {
    const tag = { "If-Match": '"' + alert.decision_revision + '"', "Content-Type": "application/json" };
    await fetch("http://127.0.0.1:" + service.port + "/v1/alerts/" + alert.id + "/acknowledge", { method: "POST", headers: tag, body: "{}" });
    relay.mend();
    await isLive(page);
    await page.waitForSelector("#banner[hidden]", { state: "attached" });
    await page.waitForSelector(".chips .acknowledged");
  });
}

async function phoneAndDark() {
  for (const colorScheme of ["light", "dark"]) {
    const { page, faults } = await openPage(browser, base, { viewport: { width: 390, height: 844 }, colorScheme, hasTouch: true });
    await page.goto(base + "/");
    await page.waitForSelector(".card");
    await check("a phone shows the inbox, " + colorScheme, async () => { await fitsPhone(page, "the inbox"); await axe(page, "the inbox"); });
    await page.locator(".card a").first().tap();
    await page.waitForSelector(".sentence");
    await page.waitForTimeout(500);
    await check("a phone shows an alert, " + colorScheme, async () => { await fitsPhone(page, "the alert"); await axe(page, "the alert"); });
    const [route] = (await api("/v1/routes")).items;
    for (const address of [...TABS.map((tab) => "#/routes/" + route.id + "/" + tab), "#/routes/" + route.id + "/map", "#/report"]) {
      await check("a phone shows " + address + ", " + colorScheme, async () => {
        await page.goto(base + "/" + address);
        await page.waitForSelector(address === "#/report" ? ".report .counts" : ".content :is(table, svg, .version, form, canvas)");
        await fitsPhone(page, address);
        await axe(page, address);
      });
    }
    await check("no error on a phone, " + colorScheme, () => equal(faults.join("\n"), "", "what went wrong"));
    await page.context().close();
  }
}

/** With keys the page asks for one, and a viewer cannot decide. */
async function signingIn() {
  const key = await makeKey(program, data, "Kim", "viewer");
  const guarded = await serve(program, data);
  const address = "http://127.0.0.1:" + guarded.port;
  const { page } = await openPage(browser, address);
  await check("a wrong key is refused in place", async () => {
    await page.goto(address + "/");
    await page.locator("#key").fill("ms_wrong");
    await axe(page, "the sign-in");
    await page.keyboard.press("Enter");
    await until(async () => (await page.locator(".refusal").textContent()) !== "", "the refusal");
  });
  await check("a viewer sees all and cannot decide", async () => {
    await page.locator("#key").fill(key);
    await page.keyboard.press("Enter");
    await page.waitForSelector(".card");
    await page.locator(".card a").first().click();
    await page.waitForSelector(".actions button");
    equal(await page.locator(".actions button:not(:disabled)").count(), 0, "the number of unlocked buttons");
    holds((await page.locator("#access").textContent()).includes("Kim"), "the page says who is signed in");
  });
  await check("who signs out is asked for a key again", async () => {
    await page.locator("#access button").click();
    await page.waitForSelector("#key");
  });
  await guarded.stop();
}

try {
  const { page, faults } = await opening();
  await check("axe accepts the page", () => axe(page, "the inbox"));
  await decidingStory({ page, api, axe, base });
  await map(page);
  await otherViews(page);
  await check("no error and no foreign request", () => equal(faults.join("\n"), "", "what went wrong"));
  await connectionLost(page);
  await phoneAndDark();
  await service.stop();
  await signingIn();
} catch (error) {
  await check("the story goes on to its end", () => { throw error; });
} finally {
  await browser.close();
  relay.close();
  await service.stop();
  fs.rmSync(data, { recursive: true, force: true });
}
process.exit(sum());
