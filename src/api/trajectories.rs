//! Where a trip went, in the map.

use std::fmt::Write;

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::problem::Problem;
use super::types::{PoseBody, timestamp};
use crate::ids::{RouteId, TripId};
use crate::store::NodeRecord;

/// A trip's way through the map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Trajectory)]
pub(super) struct TrajectoryBody {
    /// Which drive.
    trip_id: String,
    /// Every keyframe in the order of time, also those that left the active graph.
    poses: Vec<TrajectoryPoseBody>,
}

/// Where a trip was at a time.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = TrajectoryPose)]
struct TrajectoryPoseBody {
    /// The keyframe.
    node_id: i64,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    stamp: Timestamp,
    /// `map_from_base`.
    pose: PoseBody,
}

/// Read a trip's trajectory.
///
/// The optimised pose of every keyframe of the trip.
#[utoipa::path(
    get, path = "/v1/routes/{route}/trajectories/{trip}", tag = "graph",
    params(
        ("route" = String, Path, description = "Name of the route", pattern = "^[A-Za-z0-9._-]{1,64}$"),
        ("trip" = String, Path, description = "Name of the trip", pattern = "^[A-Za-z0-9._-]{1,64}$"),
    ),
    responses((status = 200, description = "The trajectory", body = TrajectoryBody))
)]
pub(super) async fn get_trajectory(
    State(state): State<ApiState>,
    ApiPath((route_id, trip_id)): ApiPath<(RouteId, TripId)>,
    _: NoQuery,
) -> Result<Json<TrajectoryBody>, Problem> {
    let nodes = keyframes(&state, &route_id, &trip_id).await?;
    let poses = nodes.into_iter().map(|node| TrajectoryPoseBody {
        node_id: node.id.0,
        stamp: timestamp(node.stamp),
        pose: node.pose.into(),
    });
    Ok(Json(TrajectoryBody {
        trip_id: trip_id.to_string(),
        poses: poses.collect(),
    }))
}

/// Read a trip's trajectory as TUM text.
///
/// Lines of `timestamp x y z qx qy qz qw`, Unix seconds, for evo and similar tools.
#[utoipa::path(
    get, path = "/v1/routes/{route}/trajectories/{trip}/tum", tag = "graph",
    params(
        ("route" = String, Path, description = "Name of the route", pattern = "^[A-Za-z0-9._-]{1,64}$"),
        ("trip" = String, Path, description = "Name of the trip", pattern = "^[A-Za-z0-9._-]{1,64}$"),
    ),
    responses((status = 200, description = "TUM lines", body = String, content_type = "text/plain"))
)]
pub(super) async fn get_trajectory_tum(
    State(state): State<ApiState>,
    ApiPath((route_id, trip_id)): ApiPath<(RouteId, TripId)>,
    _: NoQuery,
) -> Result<String, Problem> {
    let nodes = keyframes(&state, &route_id, &trip_id).await?;
    Ok(tum(&nodes))
}

async fn keyframes(
    state: &ApiState,
    route_id: &RouteId,
    trip_id: &TripId,
) -> Result<Vec<NodeRecord>, Problem> {
    state.known_route(route_id).await?;
    let mut nodes = state.store.trip_nodes(route_id, trip_id).await?;
    if nodes.is_empty() {
        return Err(Problem::not_found("trip with keyframes in the map"));
    }
    nodes.sort_by_key(|node| (node.stamp, node.id));
    Ok(nodes)
}

fn tum(nodes: &[NodeRecord]) -> String {
    let mut text = String::new();
    for node in nodes {
        let (seconds, nanoseconds) = (
            node.stamp.0.div_euclid(1_000_000_000),
            node.stamp.0.rem_euclid(1_000_000_000),
        );
        let (qz, qw) = (0.5 * node.pose.theta).sin_cos();
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{seconds}.{nanoseconds:09} {:.6} {:.6} 0 0 0 {qz:.9} {qw:.9}",
            node.pose.x, node.pose.y
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;
    use crate::ids::{BatchId, NodeId, StampNs, VehicleId};

    #[test]
    fn tum_lines_have_eight_numbers_and_a_unit_quaternion() {
        let node = NodeRecord {
            id: NodeId(1),
            batch_id: BatchId::new("b").unwrap(),
            vehicle_id: VehicleId::new("v").unwrap(),
            trip_id: TripId::new("t").unwrap(),
            stamp: StampNs(1_795_154_400_050_000_000),
            pose: Pose2::new(1.5, -2.0, -1.0),
            odom_from_base: Pose2::IDENTITY,
            drift_m: 0.0,
            reference: true,
            active: false,
            subgraph_id: None,
            trip_order: 0,
            client_id: None,
        };
        let text = tum(&[node]);
        assert_eq!(
            text,
            "1795154400.050000000 1.500000 -2.000000 0 0 0 -0.479425539 0.877582562\n"
        );
    }
}
