// Requests to the service. Whatever fails becomes an Error with the service's own words.

import { TEXTS } from "./texts.js";

const BUSY = [429, 503];
const READ_ATTEMPTS = 5;
const RETRY_MAX_S = 5;

/** Where one signs in and out, and asks who one is. */
export const SESSION = "/v1/session";

/** The service answered, and not with what was asked for. */
export class Refused extends Error {
  /**
   * @param {number} status
   * @param {{title?: string, detail?: string}} problem
   */
  constructor(status, problem) {
    super(problem.title ? problem.title + ": " + problem.detail : "HTTP " + status);
    this.status = status;
  }
}

/** Called when the session is over. */
let onSignedOut = () => {};

/** @param {() => void} listener */
export const whenSignedOut = (listener) => { onSignedOut = listener; };

/**
 * @param {string} path
 * @param {RequestInit} [options]
 */
async function askOnce(path, options) {
  try {
    return await fetch(path, options);
  } catch (cause) {
    if (options?.signal?.aborted) throw cause;
    throw new Error(TEXTS.unreachable, { cause });
  }
}

/**
 * A read that a busy service turns away is sent again when it says so.
 * @param {string} path
 * @param {RequestInit} [options]
 */
async function ask(path, options = {}) {
  const attempts = options.method ? 1 : READ_ATTEMPTS;
  for (let attempt = 1; ; attempt += 1) {
    const response = await askOnce(path, options);
    if (response.status === 401 && path !== SESSION) onSignedOut();
    if (!BUSY.includes(response.status) || attempt === attempts) return response;
    const seconds = Math.min(Number(response.headers.get("Retry-After") ?? 1), RETRY_MAX_S);
    await new Promise((resolve) => setTimeout(resolve, 1000 * seconds));
  }
}

/** @param {Response} response */
async function bodyOf(response) {
  const text = await response.text();
  const isJson = (response.headers.get("Content-Type") ?? "").includes("json");
  const body = text && isJson ? JSON.parse(text) : {};
  if (!response.ok) throw new Refused(response.status, body);
  return body;
}

/**
 * @param {string} path
 * @returns {Promise<any>}
 */
export const get = async (path) => bodyOf(await ask(path, { headers: { Accept: "application/json" } }));

/**
 * @param {string} path
 * @returns {Promise<{body: any, tag: string | null}>} with the ETag
 */
export async function getTagged(path) {
  const response = await ask(path, { headers: { Accept: "application/json" } });
  return { body: await bodyOf(response), tag: response.headers.get("ETag") };
}

/**
 * Whatever it is, such as a picture.
 * @param {string} path
 * @param {AbortSignal} [signal] ends the request
 * @returns {Promise<Blob>}
 */
export async function getBlob(path, signal) {
  const response = await ask(path, { signal });
  if (!response.ok) await bodyOf(response);
  return response.blob();
}

/**
 * @param {string} method
 * @param {string} path
 * @param {unknown} [body]
 * @param {Record<string, string>} [headers]
 * @returns {Promise<any>}
 */
export async function send(method, path, body, headers = {}) {
  const all = body === undefined ? headers : { "Content-Type": "application/json", ...headers };
  return bodyOf(await ask(path, { method, headers: all, body: body === undefined ? undefined : JSON.stringify(body) }));
}

/**
 * What is not there is null.
 * @param {string} path
 * @returns {Promise<any>}
 */
export async function getIfThere(path) {
  try {
    return await get(path);
  } catch (error) {
    if (error instanceof Refused && error.status === 404) return null;
    throw error;
  }
}

/**
 * Up to `most` items of a list.
 * @param {string} path
 * @param {number} most
 * @returns {Promise<any[]>}
 */
export async function list(path, most) {
  /** @type {any[]} */
  const items = [];
  let cursor = null;
  const glue = path.includes("?") ? "&" : "?";
  do {
    /** @type {any} */
    const page = await get(path + glue + "limit=" + Math.min(most, 1000) + (cursor ? "&cursor=" + encodeURIComponent(cursor) : ""));
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor && items.length < most);
  return items;
}

/** @param {string} route */
export const routePath = (route) => "/v1/routes/" + encodeURIComponent(route);
/** @param {string} alert */
export const alertPath = (alert) => "/v1/alerts/" + encodeURIComponent(alert);
