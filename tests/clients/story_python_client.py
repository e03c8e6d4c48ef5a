"""The story of a route, told by the client that openapi-python-client generates: story_python_client.py URL KEY."""

import sys
import time
from http import HTTPStatus
from typing import TypeVar

from mapshift_client import AuthenticatedClient
from mapshift_client.api.alerts import list_alerts
from mapshift_client.api.batches import get_batch, put_batch, put_edge_batch
from mapshift_client.api.graph import get_graph, list_nodes
from mapshift_client.api.map_ import get_map_png
from mapshift_client.api.routes import get_route, put_route
from mapshift_client.models import (
    AlertPage,
    Batch,
    BatchStatusName,
    BatchUpload,
    EdgeBatchUpload,
    Graph,
    NodePage,
    Problem,
    Route,
    RoutePut,
)
from mapshift_client.types import UNSET, File, Unset
from room import batch, edges

ROUTE = "python-client"
T = TypeVar("T")


def expect(kind: type[T], answer: object) -> T:
    assert isinstance(answer, kind), answer
    return answer


def merged(client: AuthenticatedClient, name: str) -> Batch:
    for _ in range(600):
        found = expect(Batch, get_batch.sync(ROUTE, name, client=client))
        if found.status not in (BatchStatusName.QUEUED, BatchStatusName.PROCESSING):
            assert found.status == BatchStatusName.MERGED, found
            return found
        time.sleep(0.1)
    raise AssertionError(f"{name} is not merged")


def all_nodes(client: AuthenticatedClient) -> list[int]:
    found: list[int] = []
    cursor: str | Unset = UNSET
    while True:
        answer = list_nodes.sync_detailed(ROUTE, client=client, limit=2, cursor=cursor)
        page = expect(NodePage, answer.parsed)
        found += [node.id for node in page.items]
        assert ("link" in answer.headers) == (page.next_cursor is not None), answer.headers
        if page.next_cursor is None:
            return found
        cursor = page.next_cursor


def story(client: AuthenticatedClient) -> None:
    made = put_route.sync_detailed(ROUTE, client=client, body=RoutePut(display_name="Python"))
    assert made.status_code == HTTPStatus.CREATED, made
    assert expect(Route, made.parsed).id == ROUTE

    first = BatchUpload.from_dict(batch(0))
    stored = put_batch.sync_detailed(ROUTE, "b-0", client=client, body=first)
    assert stored.status_code == HTTPStatus.ACCEPTED, stored
    again = put_batch.sync_detailed(ROUTE, "b-0", client=client, body=first)
    assert again.status_code == HTTPStatus.OK, again
    assert again.headers["idempotent-replayed"] == "true"
    second = BatchUpload.from_dict(batch(1))
    assert expect(Batch, put_batch.sync(ROUTE, "b-1", client=client, body=second)).sequence == 1
    assert merged(client, "b-0").scans == 8
    merged(client, "b-1")

    nodes = all_nodes(client)
    tied = EdgeBatchUpload.from_dict(edges(nodes[-1]))
    expect(Batch, put_edge_batch.sync(ROUTE, "e-0", client=client, body=tied))
    assert merged(client, "e-0").nodes_added == 2

    graph = expect(Graph, get_graph.sync(ROUTE, client=client))
    assert [node.id for node in graph.nodes] == all_nodes(client)
    assert expect(AlertPage, list_alerts.sync(client=client, route_id=ROUTE)).items == []
    picture = expect(File, get_map_png.sync(ROUTE, client=client))
    assert picture.payload.read().startswith(b"\x89PNG")

    missing = expect(Problem, get_route.sync("nowhere", client=client))
    assert (missing.status, missing.type_) == (404, "/problems/unknown-route"), missing
    assert client.get_httpx_client().get(missing.type_).status_code == HTTPStatus.OK
    other = expect(Problem, put_batch.sync(ROUTE, "b-0", client=client, body=second))
    assert (other.status, other.type_) == (409, "/problems/batch-id-reused"), other
    print(f"{len(graph.nodes)} nodes, {len(graph.edges)} edges")


with AuthenticatedClient(base_url=sys.argv[1], token=sys.argv[2]) as client:
    story(client)
