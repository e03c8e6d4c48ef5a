//! Nodes of a route's pose graph and their scans.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::access::Identity;
use super::batch_upload::BandBody;
use super::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::parameters::{NodeParam, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{RoutePartProblems, RouteProblems};
use super::types::{PoseBody, timestamp};
use crate::ids::{NodeId, RouteId};
use crate::scan::{LaserScan, Reading, decode_scan};
use crate::store::NodeRecord;

/// A node: where a vehicle was.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Node)]
pub(super) struct NodeBody {
    /// Unique within the route.
    id: i64,
    /// `map_from_base`.
    pose: PoseBody,
    /// Standard deviations of the pose in the map frame, relative to the first node that it hangs
    /// together with, which has zeros. From the information of the edges around it, scaled by how
    /// well loop closures agree. null where it is not known where the node is, and where they were
    /// not computed yet. Of a node that is not active any more, as they were last.
    #[schema(required)]
    sigma: Option<PoseBody>,
    /// The upload it came with.
    batch_id: String,
    /// Who drove.
    vehicle_id: String,
    /// Which drive.
    trip_id: String,
    /// When it was there.
    #[schema(value_type = String, format = DateTime)]
    stamp: Timestamp,
    /// The block of the graph it lies in; null outside every block with a loop closure.
    #[schema(required)]
    subgraph_id: Option<i64>,
    /// Whether it is known where it was. Of a vehicle that was carried, or whose odometry broke
    /// where its scans said nothing either, it is not, until its scans say it: until then the pose
    /// stands for nothing, and nothing is concluded from what was seen there.
    localised: bool,
    /// Whether later laps are tied to it.
    reference: bool,
    /// Whether it takes part in the optimisation.
    active: bool,
    /// What its vehicle calls it; null for nodes that were made here.
    #[schema(required)]
    client_id: Option<String>,
}

/// A part of a route's list of nodes.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct NodePage {
    /// By id.
    items: Vec<NodeBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for NodePage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// A node's scan.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = NodeScan)]
pub(super) struct NodeScanBody {
    /// The node.
    node_id: i64,
    /// `map_from_base`: a return at range r of beam k lies at
    /// `pose ∘ lidar.mount ∘ (r cos a, r sin a)` in the map, with
    /// `a = lidar.angle_min + k · lidar.angle_increment`.
    pose: PoseBody,
    /// When it was taken.
    #[schema(value_type = String, format = DateTime)]
    stamp: Timestamp,
    /// The lidar that took it.
    lidar: ScanLidarBody,
    /// Metres along each beam, in the lidar frame and counter-clockwise; null where there was no return,
    /// or an invalid reading.
    ranges: Vec<Option<f64>>,
    /// The beams whose readings were invalid, as places in `ranges`, ascending: they say nothing, also not
    /// that nothing is there.
    invalid_beams: Vec<usize>,
}

/// The geometry of the lidar that took a scan.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ScanLidar)]
struct ScanLidarBody {
    /// Direction of the first beam, radians.
    angle_min: f64,
    /// Direction of the last beam, radians.
    angle_max: f64,
    /// Turn from a beam to the next, radians.
    angle_increment: f64,
    /// Shorter ranges said nothing, metres.
    range_min: f64,
    /// Ranges of this length or longer counted as no return, metres.
    range_max: f64,
    /// `base_from_lidar`.
    mount: PoseBody,
    /// Standard deviation of one range, metres.
    range_sigma: f64,
    /// The heights that its scans are made of; null for a lidar that looks along one plane.
    #[schema(required)]
    band: Option<BandBody>,
}

impl From<NodeRecord> for NodeBody {
    fn from(node: NodeRecord) -> Self {
        Self {
            id: node.id.0,
            pose: node.pose.into(),
            sigma: node.sigma.map(PoseBody::from),
            batch_id: node.batch_id.to_string(),
            vehicle_id: node.vehicle_id.to_string(),
            trip_id: node.trip_id.to_string(),
            stamp: timestamp(node.stamp),
            subgraph_id: node.subgraph_id,
            localised: node.is_localised(),
            reference: node.reference,
            active: node.active,
            client_id: node.client_id,
        }
    }
}

impl NodeScanBody {
    fn new(node: &NodeRecord, scan: &LaserScan) -> Self {
        let lidar = scan.lidar();
        Self {
            node_id: node.id.0,
            pose: node.pose.into(),
            stamp: timestamp(node.stamp),
            lidar: ScanLidarBody {
                angle_min: lidar.angle_min_rad,
                angle_max: lidar.beam_angle_rad(scan.beam_count().saturating_sub(1)),
                angle_increment: lidar.angle_increment_rad,
                range_min: lidar.range_min_m,
                range_max: lidar.range_max_m,
                mount: lidar.mount.into(),
                range_sigma: lidar.range_sigma_m,
                band: lidar.band.map(BandBody::from),
            },
            ranges: scan.ranges_m().collect(),
            invalid_beams: (0..scan.beam_count())
                .filter(|beam| scan.reading(*beam) == Reading::Invalid)
                .collect(),
        }
    }
}

/// List a route's nodes.
///
/// By id, in parts.
#[utoipa::path(
    get, path = "/v1/routes/{route}/nodes", tag = "graph",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A part of the list", body = NodePage), RouteProblems)
)]
pub(super) async fn list_nodes(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<NodePage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    let after = after.map(NodeId);
    let nodes = state.store.node_page(&route_id, after, limit + 1);
    let mut nodes = nodes.await?;
    let next_cursor = cut_page(&mut nodes, limit, |node| node.id.to_string());
    Ok(Listed(NodePage {
        items: nodes.into_iter().map(NodeBody::from).collect(),
        next_cursor,
    }))
}

/// Read a node.
///
/// Its pose in the map and where it came from; for a key that uploads for one vehicle, if it is of this vehicle.
#[utoipa::path(
    get, path = "/v1/routes/{route}/nodes/{node}", tag = "graph",
    params(RouteParam, NodeParam),
    responses((status = 200, description = "The node", body = NodeBody), RoutePartProblems)
)]
pub(super) async fn get_node(
    State(state): State<ApiState>,
    identity: Identity,
    ApiPath((route_id, id)): ApiPath<(RouteId, NodeId)>,
    _: NoQuery,
) -> Result<Json<NodeBody>, Problem> {
    let node = known_node(&state, &route_id, id).await?;
    match identity.is_foreign(&node.vehicle_id) {
        true => Err(Problem::not_found("node")),
        false => Ok(Json(node.into())),
    }
}

/// Read a node's scan.
///
/// The ranges in the lidar frame, with all that is needed to draw them in the map.
#[utoipa::path(
    get, path = "/v1/routes/{route}/nodes/{node}/scan", tag = "graph",
    params(RouteParam, NodeParam),
    responses((status = 200, description = "The scan", body = NodeScanBody), RoutePartProblems)
)]
pub(super) async fn get_node_scan(
    State(state): State<ApiState>,
    ApiPath((route_id, id)): ApiPath<(RouteId, NodeId)>,
    _: NoQuery,
) -> Result<Json<NodeScanBody>, Problem> {
    let node = known_node(&state, &route_id, id).await?;
    let bytes = state.store.node_scan(&route_id, id).await?;
    let bytes = bytes.ok_or_else(|| {
        let detail = format!("node {id} came with a batch of edges: it has no scan");
        Problem::new(ProblemKind::NotFound, detail)
    })?;
    let scan = decode_scan(&bytes).map_err(Problem::internal)?;
    Ok(Json(NodeScanBody::new(&node, &scan)))
}

pub(super) async fn known_node(
    state: &ApiState,
    route_id: &RouteId,
    id: NodeId,
) -> Result<NodeRecord, Problem> {
    let node = state.store.node(route_id, id).await?;
    node.ok_or_else(|| Problem::not_found("node"))
}
