//! A route's pose graph as a whole.

use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::bounding_box::BoundingBox;
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
    /// The version of the map that the poses belong to.
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
    /// Only nodes within `x0,y0,x1,y1` (map frame, metres) and the edges between them.
    #[param(
        pattern = r"^-?[0-9]+(\.[0-9]+)?(,-?[0-9]+(\.[0-9]+)?){3}$",
        nullable = false,
        example = "-5,-5,20,15"
    )]
    bbox: Option<String>,
}

/// Read a route's pose graph.
///
/// All nodes and edges, or only the nodes within a box and the edges with both ends in it.
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

/// Writes a [`GraphBody`] as its nodes and edges are read.
struct GraphJson {
    /// The text before the nodes, between nodes and edges, and after the edges.
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

/// Writes the lines of a g2o file.
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
