// Requests to the service. Whatever fails becomes an Error with the service's own words.

export class Refused extends Error {
  constructor(status, problem) {
    super(problem.title ? problem.title + ": " + problem.detail : "HTTP " + status);
    this.status = status;
  }
}

async function answer(response) {
  const text = await response.text();
  const body = text ? JSON.parse(text) : {};
  if (!response.ok) throw new Refused(response.status, body);
  return body;
}

export async function get(path) {
  return answer(await fetch(path, { headers: { Accept: "application/json" } }));
}

export async function send(method, path, body, headers = {}) {
  const all = { "Content-Type": "application/json", ...headers };
  return answer(await fetch(path, { method, headers: all, body: body === undefined ? undefined : JSON.stringify(body) }));
}

/** What a service without that operation answers with null. */
export async function getIfThere(path) {
  try {
    return await get(path);
  } catch (error) {
    if (error instanceof Refused && error.status === 404) return null;
    throw error;
  }
}

/** Up to `most` items of a list. */
export async function list(path, most) {
  const items = [];
  let cursor = null;
  const glue = path.includes("?") ? "&" : "?";
  do {
    const page = await get(path + glue + "limit=" + Math.min(most, 1000) + (cursor ? "&cursor=" + encodeURIComponent(cursor) : ""));
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor && items.length < most);
  return items;
}

export const routePath = (route) => "/v1/routes/" + encodeURIComponent(route);
