// From a card to a decision and back, by mouse and by keyboard alone.

import { check, equal, holds, until } from "./checks.mjs";

/** @param {{page: import("playwright-core").Page, api: (path: string) => Promise<any>, axe: Function, base: string}} world */
export async function decidingStory({ page, api, axe, base }) {
  const chosen = () => page.evaluate(() => location.hash.split("/").at(-1));
  const alertOf = (id) => api("/v1/alerts/" + id);
  const post = (path, alert, body) => page.evaluate(([path, tag, body]) => fetch(path, { method: "POST", headers: { "If-Match": tag, "Content-Type": "application/json" }, body }), [path, '"' + alert.decision_revision + '"', JSON.stringify(body)]);

  await check("a card opens its alert, and its number stays", async () => {
    const card = page.locator(".card").first();
    const title = await card.locator("strong").textContent();
    await card.locator("a").click();
    await page.waitForSelector(".sentence");
    equal(await page.locator("#panel-title").textContent(), title, "the title");
    const alert = await alertOf(await chosen());
    const said = alert.summary.split(/ (since|from) /)[0];
    holds((await page.locator(".sentence").textContent()).startsWith(said), "the sentence is the service's: " + said);
  });
  await check("before, since and both are shown of all observations", async () => {
    for (const show of ["before", "since", "both"]) {
      await page.locator('.shows [data-show="' + show + '"]').click();
      await until(() => page.locator(".stack img:not([aria-hidden])").evaluate((image) => image.complete && image.naturalWidth > 100), show);
    }
    await page.locator(".fader").fill("50");
    equal(await page.locator(".stack img").nth(1).evaluate((image) => image.style.opacity), "0.5", "what fades in");
  });
  await check("a pass shows its scan", async () => {
    const pass = page.locator(".strip.since .pass.new_state").first();
    const scan = page.waitForResponse((response) => response.url().endsWith("/scan"));
    await pass.click();
    equal((await scan).status(), 200, "the scan's status");
    equal(await pass.getAttribute("aria-pressed"), "true", "the mark");
  });
  await check("axe accepts an alert", () => axe(page, "an alert"));

  await check("a half-typed note and the focus outlive a change of the alert", async () => {
    const note = page.locator(".actions textarea");
    await note.pressSequentially("half a no");
    const alert = await alertOf(await chosen());
    await post("/v1/alerts/" + alert.id + "/acknowledge", alert, {});
    await page.waitForSelector(".chips .acknowledged");
    await page.keyboard.type("te");
    equal(await note.inputValue(), "half a note", "the note");
    await note.fill("");
    await page.keyboard.press("Escape");
  });

  await check("a dismissal has its reason, opens the next alert and can be undone", async () => {
    const id = await chosen();
    await page.keyboard.press("d");
    await page.locator('dialog input[value="people"]').check();
    await axe(page, "the dismissal");
    await page.locator("dialog textarea").fill("shift change");
    await page.locator("dialog button.main").click();
    await until(async () => (await alertOf(id)).status === "dismissed", "the dismissal");
    const last = (await alertOf(id)).history.at(-1);
    equal(last.reason + ", " + last.note, "people, shift change", "why");
    await until(async () => (await chosen()) !== id, "the next alert");
    await page.locator(".toast button").last().click();
    await until(async () => (await alertOf(id)).status === "open", "the way back");
  });

  await check("accepting shows first what it changes, and then makes a version", async () => {
    const { items: [alert] } = await api("/v1/alerts?status=open&kind=appeared");
    await page.goto(base + "/#/alerts/" + alert.id);
    await page.waitForSelector(".actions button.main:not(:disabled)");
    await page.keyboard.press("a");
    await page.waitForSelector("dialog .preview dl", { timeout: 60000 });
    await axe(page, "the acceptance");
    const next = await page.locator("dialog .preview dd").first().textContent();
    await page.locator("dialog button.main").click();
    await until(async () => (await alertOf(alert.id)).status === "accepted", "the acceptance");
    await page.goto(base + "/#/routes/" + alert.route_id + "/versions");
    await page.waitForSelector('.version a[href="#/alerts/' + alert.id + '"]');
    holds((await page.locator(".version h3").allTextContents()).some((title) => title.startsWith("Version " + next + " ")), "version " + next + " is listed");
  });

  await check("several are decided at once", async () => {
    await page.goto(base + "/#/");
    const open = page.locator(".card.open input[type=checkbox]");
    await open.nth(0).check();
    await open.nth(1).check();
    const before = (await api("/v1/alerts?status=acknowledged")).items.length;
    await page.locator(".several button").first().click();
    await until(async () => (await api("/v1/alerts?status=acknowledged")).items.length === before + 2, "both");
  });

  await check("the keyboard alone suffices", async () => {
    await page.goto(base + "/#/");
    await page.keyboard.press("/");
    await page.keyboard.type("appeared");
    await until(async () => (await page.locator(".card strong").allTextContents()).every((title) => /appeared/i.test(title)), "the search");
    await page.locator("#search").fill("");
    await page.keyboard.press("Escape");
    await page.keyboard.press("j");
    const first = await chosen();
    await page.keyboard.press("j");
    await until(async () => (await chosen()) !== first, "the next one");
    await page.keyboard.press("k");
    await until(async () => (await chosen()) === first, "the one before");
    await page.keyboard.press("?");
    await page.waitForSelector("dialog dl");
    await page.keyboard.press("Escape");
    await page.waitForSelector("dialog", { state: "detached" });
    holds(await page.evaluate(() => document.activeElement !== null), "something has the focus");
  });
}
