"""The story of a route, told by the client that openapi-generator generates: story_python_generator.py URL KEY."""

import sys
import time
import urllib.request

from mapshift_generated import (
    AlertsApi,
    ApiClient,
    Batch,
    BatchesApi,
    BatchStatusName,
    BatchUpload,
    Configuration,
    EdgeBatchUpload,
    GraphApi,
    MapApi,
    Problem,
    RoutePut,
    RoutesApi,
)
from mapshift_generated.exceptions import ApiException
from room import batch, edges

ROUTE = "python-generator"


def merged(batches: BatchesApi, name: str) -> Batch:
    for _ in range(600):
        found = batches.get_batch(ROUTE, name)
        if found.status not in (BatchStatusName.QUEUED, BatchStatusName.PROCESSING):
            assert found.status == BatchStatusName.MERGED, found
            return found
        time.sleep(0.1)
    raise AssertionError(f"{name} is not merged")


def all_nodes(graph: GraphApi) -> list[int]:
    found: list[int] = []
    cursor: str | None = None
    while True:
        answer = graph.list_nodes_with_http_info(ROUTE, limit=2, cursor=cursor)
        page = answer.data
        found += [node.id for node in page.items]
        assert ("link" in (answer.headers or {})) == (page.next_cursor is not None), answer.headers
        if page.next_cursor is None:
            return found
        cursor = page.next_cursor


def problem(error: ApiException) -> Problem:
    assert isinstance(error.data, Problem), error
    return error.data


def main(url: str, key: str) -> None:
    client = ApiClient(Configuration(host=url, access_token=key))
    routes, batches, graphs = RoutesApi(client), BatchesApi(client), GraphApi(client)
    made = routes.put_route_with_http_info(ROUTE, route_put=RoutePut(display_name="Python"))
    assert (made.status_code, made.data.id) == (201, ROUTE), made

    first = BatchUpload.model_validate(batch(0))
    assert batches.put_batch_with_http_info(ROUTE, "b-0", first).status_code == 202
    again = batches.put_batch_with_http_info(ROUTE, "b-0", first)
    assert again.status_code == 200 and (again.headers or {})["idempotent-replayed"] == "true"
    second = BatchUpload.model_validate(batch(1))
    assert batches.put_batch(ROUTE, "b-1", second).sequence == 1
    assert merged(batches, "b-0").scans == 8
    merged(batches, "b-1")

    tied = EdgeBatchUpload.from_dict(edges(all_nodes(graphs)[-1]))
    assert tied is not None
    batches.put_edge_batch(ROUTE, "e-0", tied)
    assert merged(batches, "e-0").nodes_added == 2

    graph = graphs.get_graph(ROUTE)
    assert [node.id for node in graph.nodes] == all_nodes(graphs)
    assert AlertsApi(client).list_alerts(route_id=ROUTE).items == []
    assert bytes(MapApi(client).get_map_png(ROUTE)).startswith(b"\x89PNG")

    try:
        routes.get_route("nowhere")
        raise AssertionError("nowhere is a route")
    except ApiException as error:
        missing = problem(error)
    assert (missing.status, missing.type) == (404, "/problems/unknown-route"), missing
    with urllib.request.urlopen(url + missing.type) as page:
        assert page.status == 200
    try:
        batches.put_batch(ROUTE, "b-0", second)
        raise AssertionError("other bytes are taken")
    except ApiException as error:
        other = problem(error)
    assert (other.status, other.type) == (409, "/problems/batch-id-reused"), other
    print(f"{len(graph.nodes)} nodes, {len(graph.edges)} edges")


main(sys.argv[1], sys.argv[2])
