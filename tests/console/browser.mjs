// A headless Chromium that the system has, and a page that remembers what went wrong on it.

import fs from "node:fs";
import { chromium } from "playwright-core";

const PLACES = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
const ARGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];

/** The path of a Chromium, or undefined. */
export const findChromium = () => PLACES.find((place) => place && fs.existsSync(place));

/** @param {string} executablePath */
export const launch = (executablePath) => chromium.launch({ executablePath, args: ARGS });

/**
 * A page; `faults` has its errors, and requests to other hosts. A busy service that is asked again is none.
 * @param {import("playwright-core").Browser} browser
 * @param {string} base
 */
export async function openPage(browser, base, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, ...options });
  const page = await context.newPage();
  const faults = [];
  page.on("pageerror", (error) => faults.push("error: " + error.message));
  page.on("console", (message) => { if (message.type() === "error" && !/status of (429|503)/.test(message.text())) faults.push("console: " + message.text() + " " + message.location().url); });
  page.on("request", (request) => {
    const url = request.url();
    if (!url.startsWith(base) && !url.startsWith("data:") && !url.startsWith("blob:")) faults.push("foreign: " + url);
  });
  page.setDefaultTimeout(30000);
  return { page, faults };
}
