// The story of a route, told with openapi-fetch and the types that openapi-typescript generates.

import createClient from "openapi-fetch";
import { expect, key, sleep, url } from "./expect.js";
import type { components, paths } from "./generated_fetch/schema.js";
import { batch, edges } from "./room.js";

const route = "openapi-fetch";
const client = createClient<paths>({ baseUrl: url, headers: { Authorization: `Bearer ${key}` } });

async function merged(name: string): Promise<components["schemas"]["Batch"]> {
  for (let k = 0; k < 600; k++) {
    const { data, error } = await client.GET("/v1/routes/{route}/batches/{batch}", { params: { path: { route, batch: name } } });
    expect(data !== undefined, error);
    if (data.status === "merged") return data;
    expect(data.status === "queued" || data.status === "processing", data);
    await sleep(100);
  }
  throw new Error(name + " is not merged");
}

async function allNodes(): Promise<number[]> {
  const found: number[] = [];
  for (let cursor: string | undefined; ;) {
    const query = cursor === undefined ? { limit: 2 } : { limit: 2, cursor };
    const { data, error, response } = await client.GET("/v1/routes/{route}/nodes", { params: { path: { route }, query } });
    expect(data !== undefined, error);
    found.push(...data.items.map((node) => node.id));
    expect(response.headers.has("link") === (data.next_cursor !== null), [...response.headers]);
    if (data.next_cursor === null) return found;
    cursor = data.next_cursor;
  }
}

const made = await client.PUT("/v1/routes/{route}", { params: { path: { route } }, body: { display_name: "TypeScript" } });
expect(made.response.status === 201 && made.data?.id === route, made.error);

const put = (name: string, sequence: number) =>
  client.PUT("/v1/routes/{route}/batches/{batch}", { params: { path: { route, batch: name } }, body: batch(sequence) });
const stored = await put("b-0", 0);
expect(stored.response.status === 202, stored.error);
const again = await put("b-0", 0);
expect(again.response.status === 200 && again.response.headers.get("idempotent-replayed") === "true", again.error);
const second = await put("b-1", 1);
expect(second.data?.sequence === 1, second.error);
expect((await merged("b-0")).scans === 8, "b-0");
await merged("b-1");

const tied = await client.PUT("/v1/routes/{route}/edge-batches/{batch}", {
  params: { path: { route, batch: "e-0" } },
  body: edges((await allNodes()).at(-1) ?? 0),
});
expect(tied.data !== undefined, tied.error);
expect((await merged("e-0")).nodes_added === 2, "e-0");

const graph = await client.GET("/v1/routes/{route}/graph", { params: { path: { route } } });
expect(graph.data !== undefined, graph.error);
expect(String(graph.data.nodes.map((node) => node.id)) === String(await allNodes()), graph.data.nodes);
const alerts = await client.GET("/v1/alerts", { params: { query: { route_id: route } } });
expect(alerts.data?.items.length === 0, alerts.error);
const picture = await client.GET("/v1/routes/{route}/map.png", { params: { path: { route } }, parseAs: "arrayBuffer" });
expect(picture.data !== undefined, picture.error);
expect(String(new Uint8Array(picture.data).slice(0, 4)) === "137,80,78,71", "map.png");

const missing = await client.GET("/v1/routes/{route}", { params: { path: { route: "nowhere" } } });
expect(missing.error?.status === 404 && missing.error.type === "/problems/unknown-route", missing.error);
expect((await fetch(new URL(missing.error.type, url))).ok, missing.error);
const other = await put("b-0", 1);
expect(other.error?.status === 409 && other.error.type === "/problems/batch-id-reused", other.error);
console.log(`${graph.data.nodes.length} nodes, ${graph.data.edges.length} edges`);
