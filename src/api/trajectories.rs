//! The trajectory of a trip in the map.

use std::fmt::Write;

use axum::extract::State;
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::access::Identity;
use super::export::{self, Document, Members};
use super::extract::{ApiPath, ApiQuery};
use super::nodes::known_node;
use super::parameters::{RouteParam, TripParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use super::types::{PoseBody, timestamp};
use super::vehicles::field_of;
use crate::calibration::AppliedCorrection;
use crate::ids::{RouteId, TripId};
use crate::store::{Pieces, TrajectoryPose};

/// A trip's trajectory in the map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Trajectory)]
pub(super) struct TrajectoryBody {
    /// The trip.
    trip_id: String,
    /// The corrections of its vehicle that were known when it began, and are applied to it.
    corrections: Vec<TripCorrectionBody>,
    /// In the order of time, archived nodes included.
    poses: Vec<TrajectoryPoseBody>,
}

/// A correction that is applied to a trip.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = TripCorrection)]
struct TripCorrectionBody {
    /// The lidar that it was estimated from; null for the vehicle's only one.
    #[schema(required)]
    lidar: Option<String>,
    /// What is corrected: the name of a field of the vehicle's `calibration`.
    quantity: &'static str,
    /// The correction, in the unit of that field.
    value: f64,
    /// Its standard error.
    sigma: f64,
}

/// The pose of a trip at a time.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = TrajectoryPose)]
struct TrajectoryPoseBody {
    /// The keyframe that the scan belongs to.
    node_id: i64,
    /// Whether the scan is that keyframe; false for a scan between keyframes.
    keyframe: bool,
    /// When the scan was taken.
    #[schema(value_type = String, format = DateTime)]
    stamp: Timestamp,
    /// `map_from_base`.
    pose: PoseBody,
}

/// Which poses of a trip to send.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum PosesName {
    /// Every keyframe.
    #[default]
    Keyframes,
    /// Every uploaded scan: keyframes and the scans between them.
    All,
}

/// Which poses of a trip to send.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct TrajectoryQuery {
    /// `keyframes` (the default), or `all` for every uploaded scan.
    #[param(nullable = false, inline)]
    poses: Option<PosesName>,
}

/// Read a trip's trajectory.
///
/// The optimised pose of every keyframe of the trip, or of every uploaded scan; a scan between keyframes moves
/// rigidly with the keyframe before it. A key that uploads for one vehicle reads only that vehicle's trips, so
/// that the vehicle can find itself in the map.
#[utoipa::path(
    get, path = "/v1/routes/{route}/trajectories/{trip}", tag = "graph",
    params(RouteParam, TripParam, TrajectoryQuery),
    responses((status = 200, description = "The trajectory", body = TrajectoryBody), RoutePartProblems)
)]
pub(super) async fn get_trajectory(
    State(state): State<ApiState>,
    identity: Identity,
    ApiPath((route_id, trip_id)): ApiPath<(RouteId, TripId)>,
    ApiQuery(query): ApiQuery<TrajectoryQuery>,
) -> Result<Response, Problem> {
    let (first, pieces) = poses(&state, &route_id, &trip_id, &query).await?;
    check_own(&state, &identity, &route_id, &first).await?;
    let start = state.store.trip_start(&route_id, &trip_id).await?;
    let corrections = start.unwrap_or_default().corrections;
    let corrections = corrections.applied().iter().map(correction_body);
    let document = TrajectoryJson::new(&TrajectoryBody {
        trip_id: trip_id.to_string(),
        corrections: corrections.collect(),
        poses: Vec::new(),
    });
    let document = document.map_err(Problem::internal)?;
    Ok(export::send(Some(first), pieces, document))
}

fn correction_body(applied: &AppliedCorrection) -> TripCorrectionBody {
    TripCorrectionBody {
        lidar: applied.lidar.as_ref().map(ToString::to_string),
        quantity: field_of(applied.quantity),
        value: applied.estimate.value,
        sigma: applied.estimate.sigma,
    }
}

/// Read a trip's trajectory as TUM text.
///
/// One line `timestamp x y z qx qy qz qw` for every keyframe, or for every uploaded scan; the time stamp is in
/// Unix seconds. For evo and similar tools.
#[utoipa::path(
    get, path = "/v1/routes/{route}/trajectories/{trip}/tum", tag = "graph",
    params(RouteParam, TripParam, TrajectoryQuery),
    responses((status = 200, description = "TUM lines", body = String, content_type = "text/plain"), RoutePartProblems)
)]
pub(super) async fn get_trajectory_tum(
    State(state): State<ApiState>,
    ApiPath((route_id, trip_id)): ApiPath<(RouteId, TripId)>,
    ApiQuery(query): ApiQuery<TrajectoryQuery>,
) -> Result<Response, Problem> {
    let (first, pieces) = poses(&state, &route_id, &trip_id, &query).await?;
    Ok(export::send(Some(first), pieces, TrajectoryTum))
}

type Poses = Vec<TrajectoryPose>;

/// The requested poses in the order of time: the first piece, and the rest.
async fn poses(
    state: &ApiState,
    route_id: &RouteId,
    trip_id: &TripId,
    query: &TrajectoryQuery,
) -> Result<(Poses, Pieces<Poses>), Problem> {
    let all = query.poses.unwrap_or_default() == PosesName::All;
    let poses = state.store.export_trajectory(route_id, trip_id, all);
    let mut poses = poses.await?;
    let first = poses.next().await?;
    let first = first.ok_or_else(unknown_trip)?;
    Ok((first, poses))
}

/// Refuses a vehicle another vehicle's trip, as if that did not exist.
async fn check_own(
    state: &ApiState,
    identity: &Identity,
    route_id: &RouteId,
    first: &Poses,
) -> Result<(), Problem> {
    let (Some(_), Some(pose)) = (identity.own_vehicle(), first.first()) else {
        return Ok(());
    };
    let node = known_node(state, route_id, pose.node_id).await?;
    match identity.is_foreign(&node.vehicle_id) {
        true => Err(unknown_trip()),
        false => Ok(()),
    }
}

fn unknown_trip() -> Problem {
    Problem::not_found("trip with keyframes in the map")
}

/// Writes a [`TrajectoryBody`] as its poses are read.
struct TrajectoryJson {
    /// The text before and after the poses.
    frame: [String; 2],
    poses: Members,
}

impl TrajectoryJson {
    fn new(without_poses: &TrajectoryBody) -> Result<Self, serde_json::Error> {
        let empty = serde_json::to_string(without_poses)?;
        let (before, after) = empty.rsplit_once("[]").unwrap_or_default();
        Ok(Self {
            frame: [format!("{before}["), format!("]{after}")],
            poses: Members::default(),
        })
    }
}

impl Document<Poses> for TrajectoryJson {
    const MEDIA_TYPE: &'static str = "application/json";

    fn begin(&mut self, text: &mut String) {
        text.push_str(&self.frame[0]);
    }

    fn append(&mut self, poses: Poses, text: &mut String) -> Result<(), serde_json::Error> {
        let mut poses = poses.into_iter().map(TrajectoryPoseBody::from);
        poses.try_for_each(|pose| self.poses.append(&pose, text))
    }

    fn end(&mut self, text: &mut String) {
        text.push_str(&self.frame[1]);
    }
}

impl From<TrajectoryPose> for TrajectoryPoseBody {
    fn from(pose: TrajectoryPose) -> Self {
        Self {
            node_id: pose.node_id.0,
            keyframe: pose.is_keyframe,
            stamp: timestamp(pose.stamp),
            pose: pose.pose.into(),
        }
    }
}

/// Writes the lines of a TUM file.
struct TrajectoryTum;

impl Document<Poses> for TrajectoryTum {
    const MEDIA_TYPE: &'static str = "text/plain; charset=utf-8";

    fn append(&mut self, poses: Poses, text: &mut String) -> Result<(), serde_json::Error> {
        for pose in &poses {
            write_tum(pose, text);
        }
        Ok(())
    }
}

fn write_tum(TrajectoryPose { stamp, pose, .. }: &TrajectoryPose, text: &mut String) {
    let (seconds, nanoseconds) = (
        stamp.0.div_euclid(1_000_000_000),
        stamp.0.rem_euclid(1_000_000_000),
    );
    let (qz, qw) = (0.5 * pose.theta).sin_cos();
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "{seconds}.{nanoseconds:09} {:.6} {:.6} 0 0 0 {qz:.9} {qw:.9}",
        pose.x, pose.y
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;
    use crate::ids::{NodeId, StampNs};

    #[test]
    fn tum_lines_have_eight_numbers_and_a_unit_quaternion() {
        let pose = TrajectoryPose {
            node_id: NodeId(1),
            is_keyframe: true,
            stamp: StampNs(1_795_154_400_050_000_000),
            pose: Pose2::new(1.5, -2.0, -1.0),
        };
        let mut text = String::new();
        write_tum(&pose, &mut text);
        assert_eq!(
            text,
            "1795154400.050000000 1.500000 -2.000000 0 0 0 -0.479425539 0.877582562\n"
        );
    }
}
