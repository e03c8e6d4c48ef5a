//! A route's pose graph as a whole.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::edges::EdgeBody;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::nodes::NodeBody;
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RouteProblems;
use crate::graph::{Edge, Node, PoseGraph};
use crate::ids::{NodeId, RouteId};
use crate::ingest::g2o::write_g2o;
use crate::store::{EdgeRecord, NodeRecord, RouteRecord};

/// A route's pose graph.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Graph)]
pub(super) struct GraphBody {
    /// Which map the poses belong to.
    map_version: i64,
    /// By id.
    nodes: Vec<NodeBody>,
    /// By id.
    edges: Vec<EdgeBody>,
}

/// Which part of the graph to send.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct GraphQuery {
    /// `x0,y0,x1,y1` in the map frame, metres: only nodes within, and edges between them.
    #[param(nullable = false, example = "-5,-5,20,15")]
    bbox: Option<String>,
}

/// A rectangle in the map frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BoundingBox {
    x: [f64; 2],
    y: [f64; 2],
}

impl std::str::FromStr for BoundingBox {
    type Err = Problem;

    fn from_str(text: &str) -> Result<Self, Problem> {
        let refuse = || {
            Problem::parameter(
                "bbox",
                "bbox is x0,y0,x1,y1 in metres, with x0 < x1 and y0 < y1",
            )
        };
        let numbers: Result<Vec<f64>, _> = text.split(',').map(str::parse).collect();
        match numbers.map_err(|_| refuse())?[..] {
            [x0, y0, x1, y1]
                if x0 < x1 && y0 < y1 && [x0, y0, x1, y1].iter().all(|v| v.is_finite()) =>
            {
                Ok(Self {
                    x: [x0, x1],
                    y: [y0, y1],
                })
            }
            _ => Err(refuse()),
        }
    }
}

impl BoundingBox {
    /// Lowest x, lowest y, highest x, highest y.
    pub(super) fn bounds(&self) -> [f64; 4] {
        [self.x[0], self.y[0], self.x[1], self.y[1]]
    }

    fn holds(&self, node: &NodeRecord) -> bool {
        (self.x[0]..=self.x[1]).contains(&node.pose.x)
            && (self.y[0]..=self.y[1]).contains(&node.pose.y)
    }
}

/// Read a route's pose graph.
///
/// All nodes and edges, or those in a box: nodes within it, and edges with both ends within it.
#[utoipa::path(
    get, path = "/v1/routes/{route}/graph", tag = "graph",
    params(RouteParam, GraphQuery),
    responses((status = 200, description = "The graph", body = GraphBody), RouteProblems)
)]
pub(super) async fn get_graph(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<GraphQuery>,
) -> Result<Response, Problem> {
    let within: Option<BoundingBox> = query.bbox.as_deref().map(str::parse).transpose()?;
    let (route, nodes, edges) = load(&state, &route_id).await?;
    let document = state.rendering.run(move || {
        let nodes: Vec<NodeRecord> = match within {
            Some(within) => nodes.into_iter().filter(|n| within.holds(n)).collect(),
            None => nodes,
        };
        let known = |id: NodeId| nodes.binary_search_by_key(&id, |node| node.id).is_ok();
        let edges = edges.into_iter().filter(|e| known(e.from) && known(e.to));
        let edges: Vec<EdgeBody> = edges.map(EdgeBody::from).collect();
        serde_json::to_vec(&GraphBody {
            map_version: route.map_version,
            nodes: nodes.into_iter().map(NodeBody::from).collect(),
            edges,
        })
    });
    let document = document.await?.map_err(Problem::internal)?;
    let media_type = [(header::CONTENT_TYPE, "application/json")];
    Ok((media_type, document).into_response())
}

/// Read a route's pose graph as g2o text.
///
/// All nodes and the active edges, with information matrices, for other optimisers.
#[utoipa::path(
    get, path = "/v1/routes/{route}/graph.g2o", tag = "graph",
    params(RouteParam),
    responses((status = 200, description = "VERTEX_SE2 and EDGE_SE2 lines", body = String, content_type = "text/plain"), RouteProblems)
)]
pub(super) async fn get_graph_g2o(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let (_, nodes, edges) = load(&state, &route_id).await?;
    let text = state.rendering.run(move || {
        let graph = pose_graph(&nodes, &edges)?;
        Ok(write_g2o(&graph))
    });
    let text = text
        .await?
        .map_err(|error: crate::graph::GraphError| Problem::internal(error))?;
    Ok(text.into_response())
}

type Loaded = (RouteRecord, Vec<NodeRecord>, Vec<EdgeRecord>);

async fn load(state: &ApiState, route_id: &RouteId) -> Result<Loaded, Problem> {
    let route = state.known_route(route_id).await?;
    // Edges first: what is added in between is a node without its edge, never the reverse.
    let edges = state.store.edges(route_id).await?;
    let nodes = state.store.nodes(route_id).await?;
    Ok((route, nodes, edges))
}

fn pose_graph(
    nodes: &[NodeRecord],
    edges: &[EdgeRecord],
) -> Result<PoseGraph, crate::graph::GraphError> {
    let mut graph = PoseGraph::new();
    for node in nodes {
        graph.add_node(Node {
            id: node.id,
            pose: node.pose,
        })?;
    }
    for edge in edges {
        graph.add_edge(Edge {
            id: edge.id,
            from: edge.from,
            to: edge.to,
            measurement: edge.measurement,
            information: edge.information,
            kind: edge.kind,
            status: edge.status,
        })?;
    }
    Ok(graph)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_read_strictly() {
        let good: BoundingBox = "-5,-5.5,20,1e1".parse().unwrap();
        assert_eq!(good.x, [-5.0, 20.0]);
        assert_eq!(good.y, [-5.5, 10.0]);
        for bad in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "1,2,1,4",
            "3,2,1,4",
            "a,b,c,d",
            "nan,0,1,1",
            "0,0,inf,1",
        ] {
            assert!(bad.parse::<BoundingBox>().is_err(), "{bad}");
        }
    }
}
