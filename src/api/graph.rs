//! A route's pose graph as a whole.

use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::edges::EdgeBody;
use super::export::{self, Document, Members};
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::nodes::NodeBody;
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RouteProblems;
use crate::ids::RouteId;
use crate::ingest::g2o::{write_edge, write_vertex};
use crate::model::EdgeStatus;
use crate::store::{GraphPart, Within};

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
    #[param(
        pattern = r"^-?[0-9]+(\.[0-9]+)?(,-?[0-9]+(\.[0-9]+)?){3}$",
        nullable = false,
        example = "-5,-5,20,15"
    )]
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
}

impl From<BoundingBox> for Within {
    fn from(BoundingBox { x, y }: BoundingBox) -> Self {
        Self { x, y }
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
    let route = state.known_route(&route_id).await?;
    let within = within.map(Within::from);
    let mut pieces = state.store.export_graph(&route_id, within).await?;
    let first = pieces.next().await?;
    let document = GraphJson::new(route.map_version).map_err(Problem::internal)?;
    Ok(export::send(first, pieces, document))
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
    let mut pieces = state.store.export_graph(&route_id, None).await?;
    let first = pieces.next().await?;
    Ok(export::send(first, pieces, GraphG2o))
}

/// [`GraphBody`], its nodes and edges as they come.
struct GraphJson {
    /// What comes before the nodes, between them and the edges, and after these.
    frame: [String; 3],
    nodes: Members,
    edges: Option<Members>,
}

impl GraphJson {
    fn new(map_version: i64) -> Result<Self, serde_json::Error> {
        let empty = serde_json::to_string(&GraphBody {
            map_version,
            nodes: Vec::new(),
            edges: Vec::new(),
        })?;
        let mut parts = empty.split("[]");
        let mut part = || parts.next().unwrap_or_default();
        Ok(Self {
            frame: [
                format!("{}[", part()),
                format!("]{}[", part()),
                format!("]{}", part()),
            ],
            nodes: Members::default(),
            edges: None,
        })
    }

    fn edges(&mut self, text: &mut String) -> &mut Members {
        self.edges.get_or_insert_with(|| {
            text.push_str(&self.frame[1]);
            Members::default()
        })
    }
}

impl Document<GraphPart> for GraphJson {
    const MEDIA_TYPE: &'static str = "application/json";

    fn begin(&mut self, text: &mut String) {
        text.push_str(&self.frame[0]);
    }

    fn append(&mut self, part: GraphPart, text: &mut String) -> Result<(), serde_json::Error> {
        match part {
            GraphPart::Nodes(nodes) => {
                let mut nodes = nodes.into_iter().map(NodeBody::from);
                nodes.try_for_each(|node| self.nodes.append(&node, text))
            }
            GraphPart::Edges(edges) => {
                let members = self.edges(text);
                let mut edges = edges.into_iter().map(EdgeBody::from);
                edges.try_for_each(|edge| members.append(&edge, text))
            }
        }
    }

    fn end(&mut self, text: &mut String) {
        self.edges(text);
        text.push_str(&self.frame[2]);
    }
}

/// The lines of a g2o file.
struct GraphG2o;

impl Document<GraphPart> for GraphG2o {
    const MEDIA_TYPE: &'static str = "text/plain; charset=utf-8";

    fn append(&mut self, part: GraphPart, text: &mut String) -> Result<(), serde_json::Error> {
        match part {
            GraphPart::Nodes(nodes) => {
                for node in nodes {
                    write_vertex(text, node.id, &node.pose);
                }
            }
            GraphPart::Edges(edges) => {
                let active = edges.iter().filter(|e| e.status == EdgeStatus::Active);
                for edge in active {
                    let ends = [edge.from, edge.to];
                    write_edge(text, ends, &edge.measurement, &edge.information);
                }
            }
        }
        Ok(())
    }
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
