//! Nodes of a route's pose graph and their scans.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::access::Identity;
use super::batch_upload::BandBody;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::paging::{Listed, PageQuery, page};
use super::parameters::{NodeParam, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{RoutePartProblems, RouteProblems};
use super::types::{PoseBody, timestamp};
use crate::ids::{NodeId, RouteId};
use crate::scan::{LaserScan, Reading, decode_scan};
use crate::store::NodeRecord;

/// A node of the pose graph: the pose of a vehicle at a keyframe.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Node)]
pub(super) struct NodeBody {
    /// Unique within the route.
    id: i64,
    /// `map_from_base`.
    pose: PoseBody,
    /// Standard deviations of the pose in the map frame, relative to the first node that it is connected
    /// with, whose own are zero. Computed from the information of the edges around it and scaled by how well
    /// loop closures agree. Null for a node that is not localised, and before they are first computed. An
    /// archived node keeps its last values.
    #[schema(required)]
    sigma: Option<PoseBody>,
    /// The batch that it came with.
    batch_id: String,
    /// The vehicle.
    vehicle_id: String,
    /// The trip.
    trip_id: String,
    /// When its scan was taken.
    #[schema(value_type = String, format = DateTime)]
    stamp: Timestamp,
    /// The sub-graph that it belongs to; null if it is in no block with a loop closure.
    #[schema(required)]
    subgraph_id: Option<i64>,
    /// Whether its place in the map is known. It is not if the vehicle was carried, or if its odometry failed
    /// where scans did not help, until later scans are matched with the map. Until then the pose is meaningless,
    /// and nothing is concluded from its scan.
    localised: bool,
    /// Whether it is a reference keyframe, which later passes are matched with.
    reference: bool,
    /// Whether it takes part in the optimisation.
    active: bool,
    /// The vehicle's own id of it, for nodes uploaded with edges; null for nodes made from scans.
    #[schema(required)]
    client_id: Option<String>,
}

page! {
    /// A page of a route's list of nodes.
    pub(super) struct NodePage {
        /// By id.
        items: Vec<NodeBody>,
    }
}

/// A node's scan.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = NodeScan)]
pub(super) struct NodeScanBody {
    /// The node.
    node_id: i64,
    /// `map_from_base`: a return of beam k at range r is at
    /// `pose ∘ lidar.mount ∘ (r cos a, r sin a)` in the map, with
    /// `a = lidar.angle_min + k · lidar.angle_increment`.
    pose: PoseBody,
    /// When the scan was taken.
    #[schema(value_type = String, format = DateTime)]
    stamp: Timestamp,
    /// The lidar that took it.
    lidar: ScanLidarBody,
    /// The range of each beam, metres, counter-clockwise in the lidar frame; null for no return or an invalid
    /// reading.
    ranges: Vec<Option<f64>>,
    /// Indices in `ranges` of beams with invalid readings, ascending: these say nothing, not even that the beam
    /// is free.
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
    /// Angle from one beam to the next, radians.
    angle_increment: f64,
    /// Shorter ranges count as invalid, metres.
    range_min: f64,
    /// Ranges of this length or more count as no return, metres.
    range_max: f64,
    /// `base_from_lidar`.
    mount: PoseBody,
    /// Standard deviation of one range, metres.
    range_sigma: f64,
    /// The height band that its scans were made from; null for a lidar that scans a single plane.
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
/// By id.
#[utoipa::path(
    get, path = "/v1/routes/{route}/nodes", tag = "graph",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A page of the list", body = NodePage), RouteProblems)
)]
pub(super) async fn list_nodes(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<NodePage>, Problem> {
    let wanted = query.wanted::<i64>()?;
    let after = wanted.after.map(NodeId);
    let nodes = state.store.node_page(&route_id, after, wanted.to_read());
    Ok(wanted.page(nodes.await?, |node| node.id, NodeBody::from))
}

/// Read a node.
///
/// Its pose in the map, and the upload that it came with. A key that uploads for one vehicle reads only that
/// vehicle's nodes.
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
/// The ranges in the lidar frame, with everything needed to draw them in the map.
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
        let detail = format!("node {id} was uploaded with edges: it has no scan");
        Problem::new(ProblemKind::NotFound, detail)
    })?;
    let scan = decode_scan(&bytes).map_err(Problem::internal)?;
    Ok(Json(NodeScanBody::new(&node, &scan)))
}

/// A node as it is now.
///
/// # Errors
/// The [`Problem`] that there is none.
pub(super) async fn known_node(
    state: &ApiState,
    route_id: &RouteId,
    id: NodeId,
) -> Result<NodeRecord, Problem> {
    let node = state.store.node(route_id, id).await?;
    node.ok_or_else(|| Problem::not_found("node"))
}
