//! What viewers draw over a map: trajectories, loop closures, keyframes. Bounded, however old the route is.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RouteProblems;
use super::types::{PoseBody, timestamp};
use crate::geometry::{Pose2, Vector2};
use crate::ids::RouteId;
use crate::model::EdgeKind;
use crate::store::{ActiveClosure, TripTrack};

/// Points of all trips together by default.
const POINTS: u32 = 5_000;
const POINTS_MIN: u32 = 100;
const POINTS_MAX: u32 = 50_000;
/// Most trips shown: fewer than half of [`POINTS_MIN`], so that each has its two ends.
const TRIPS_MAX: usize = 40;
/// Loop closures by default.
const CLOSURES: u32 = 500;
const CLOSURES_MAX: u32 = 5_000;
/// Most reference keyframes shown.
const KEYFRAMES_MAX: usize = 5_000;

/// How much of trajectories to send.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PointsQuery {
    /// The most points to send for all trips together; 5,000 by default.
    #[param(minimum = 100, maximum = 50000, nullable = false)]
    max_points: Option<u32>,
}

/// How many loop closures to send.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ClosuresQuery {
    /// The most loop closures to send; 500 by default.
    #[param(minimum = 1, maximum = 5000, nullable = false)]
    limit: Option<u32>,
}

/// The trajectories of the newest trips.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct TrajectoryLayer {
    /// The trip with the newest keyframe first; at most 40.
    items: Vec<TrackBody>,
}

/// The trajectory of a trip.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = TrajectoryLayerItem)]
struct TrackBody {
    /// Its name.
    trip_id: String,
    /// Its vehicle.
    vehicle_id: String,
    /// x and y of keyframes in the order of time, map frame, metres, rounded to centimetres: an even selection that
    /// includes the first and the last.
    points: Vec<[f64; 2]>,
    /// The stamp of its last keyframe.
    #[schema(value_type = String, format = DateTime)]
    last_stamp: Timestamp,
    /// The pose of its last keyframe; null if the vehicle has a newer trip in the list.
    #[schema(required)]
    last_pose: Option<PoseBody>,
}

/// The loop closures with the largest residuals.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ResidualLayer {
    /// The largest residual first.
    items: Vec<ClosureBody>,
}

/// A loop closure as a line.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ResidualLayerItem)]
struct ClosureBody {
    /// Its edge.
    edge_id: i64,
    /// x and y of its older node, map frame, metres, rounded to centimetres.
    from: [f64; 2],
    /// x and y of its newer node.
    to: [f64; 2],
    /// eᵀΩe at the current poses.
    residual: f64,
    /// How it was measured.
    kind: EdgeKind,
}

/// The positions of the reference keyframes.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct KeyframeLayer {
    /// x and y by id, map frame, metres, rounded to centimetres; an even selection if there are more than 5,000.
    points: Vec<[f64; 2]>,
}

/// Read the trajectories of the newest trips as a layer of the map.
///
/// For viewers: at most 40 trips, thinned to `max_points` in all. `…/trajectories/{trip}` has every pose of a trip.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map/layers/trajectories", tag = "map",
    params(RouteParam, PointsQuery),
    responses((status = 200, description = "The layer", body = TrajectoryLayer), RouteProblems)
)]
pub(super) async fn get_trajectory_layer(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PointsQuery>,
) -> Result<Json<TrajectoryLayer>, Problem> {
    let asked = query.max_points.unwrap_or(POINTS);
    let points = within("max_points", asked, POINTS_MIN, POINTS_MAX)?;
    let tracks = state.store.newest_tracks(&route_id, TRIPS_MAX).await?;
    let items = layer_of(&tracks, points);
    Ok(Json(TrajectoryLayer { items }))
}

/// Read the loop closures with the largest residuals as a layer of the map.
///
/// For viewers: only loop closures that take part in the optimisation. `…/edges` has all.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map/layers/residuals", tag = "map",
    params(RouteParam, ClosuresQuery),
    responses((status = 200, description = "The layer", body = ResidualLayer), RouteProblems)
)]
pub(super) async fn get_residual_layer(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<ClosuresQuery>,
) -> Result<Json<ResidualLayer>, Problem> {
    let limit = within("limit", query.limit.unwrap_or(CLOSURES), 1, CLOSURES_MAX)?;
    let closures = state.store.worst_closures(&route_id, limit).await?;
    let items = closures.into_iter().map(ClosureBody::from).collect();
    Ok(Json(ResidualLayer { items }))
}

/// Read the positions of the reference keyframes as a layer of the map.
///
/// For viewers: new passes are matched with these keyframes. `…/nodes` has all their fields.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map/layers/keyframes", tag = "map",
    params(RouteParam),
    responses((status = 200, description = "The layer", body = KeyframeLayer), RouteProblems)
)]
pub(super) async fn get_keyframe_layer(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    _: NoQuery,
) -> Result<Json<KeyframeLayer>, Problem> {
    let positions = state.store.reference_positions(&route_id).await?;
    let points = evenly(&positions, KEYFRAMES_MAX).map(rounded).collect();
    Ok(Json(KeyframeLayer { points }))
}

fn within(name: &str, asked: u32, least: u32, most: u32) -> Result<usize, Problem> {
    if (least..=most).contains(&asked) {
        return Ok(asked as usize);
    }
    let refusal = format!("{name} is a number from {least} to {most}");
    Err(Problem::parameter(name, refusal))
}

/// The tracks with `points` points in all: each has its two ends, and a share of the rest by its length.
fn layer_of(tracks: &[TripTrack], points: usize) -> Vec<TrackBody> {
    let all: usize = tracks.iter().map(|track| track.poses.len()).sum();
    let rest = points.saturating_sub(2 * tracks.len());
    let mut vehicles = Vec::new();
    let mut items = Vec::new();
    for track in tracks {
        let Some((last_stamp, last_pose)) = track.poses.last() else {
            continue;
        };
        let is_newest = !vehicles.contains(&&track.vehicle_id);
        vehicles.push(&track.vehicle_id);
        let share = 2 + rest * track.poses.len() / all;
        items.push(TrackBody {
            trip_id: track.trip_id.to_string(),
            vehicle_id: track.vehicle_id.to_string(),
            points: evenly(&track.poses, share)
                .map(|(_, pose)| rounded(&position(pose)))
                .collect(),
            last_stamp: timestamp(*last_stamp),
            last_pose: is_newest.then(|| (*last_pose).into()),
        });
    }
    items
}

/// An even selection of at most `most` (at least 2) items, including the first and the last.
fn evenly<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    let count = all.len().min(most);
    let last = all.len().saturating_sub(1);
    (0..count).map(move |k| &all[k * last / (count - 1).max(1)])
}

fn position(pose: &Pose2) -> Vector2<f64> {
    Vector2::new(pose.x, pose.y)
}

/// To centimetres.
fn rounded(point: &Vector2<f64>) -> [f64; 2] {
    [point.x, point.y].map(|metres| (metres * 100.0).round() / 100.0)
}

impl From<ActiveClosure> for ClosureBody {
    fn from(closure: ActiveClosure) -> Self {
        let [from, to] = closure.ends;
        Self {
            edge_id: closure.edge_id.0,
            from: rounded(&from),
            to: rounded(&to),
            residual: closure.residual,
            kind: closure.kind,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::{StampNs, TripId, VehicleId};

    fn track(trip: &str, vehicle: &str, keyframes: i32) -> TripTrack {
        let pose = |k| Pose2::new(f64::from(k) * 0.504, 1.0, 0.0);
        TripTrack {
            trip_id: TripId::new(trip).unwrap(),
            vehicle_id: VehicleId::new(vehicle).unwrap(),
            poses: (0..keyframes)
                .map(|k| (StampNs(i64::from(k)), pose(k)))
                .collect(),
        }
    }

    #[test]
    fn thinned_tracks_keep_their_ends_and_the_bound() {
        let tracks = [
            track("c", "agv-1", 1),
            track("b", "agv-2", 7_000),
            track("a", "agv-1", 3_000),
        ];
        for points in [100, 999, 5_000, 50_000] {
            let layer = layer_of(&tracks, points);
            let counts: Vec<_> = layer.iter().map(|item| item.points.len()).collect();
            let sum: usize = counts.iter().sum();
            assert!(sum <= points && sum >= points.min(10_001) - 5, "{counts:?}");
            assert_eq!(counts[0], 1);
            for (item, track) in layer.iter().zip(&tracks) {
                let end = track.poses.last().unwrap().1;
                assert_eq!(item.points[0], [0.0, 1.0]);
                assert_eq!(item.points.last(), Some(&rounded(&position(&end))));
            }
        }
        let layer = layer_of(&tracks, 50_000);
        assert_eq!(layer[1].points[1], [0.5, 1.0], "to centimetres");
        let has_last = |k: usize| layer[k].last_pose.is_some();
        assert_eq!([0, 1, 2].map(has_last), [true, true, false]);
    }

    #[test]
    fn few_are_all_taken() {
        let evenly = |all: &[i32], most| evenly(all, most).copied().collect::<Vec<_>>();
        assert_eq!(evenly(&[], 5), [0; 0]);
        assert_eq!(evenly(&[7], 5), [7]);
        assert_eq!(evenly(&[1, 2, 3], 3), [1, 2, 3]);
        assert_eq!(evenly(&[1, 2, 3, 4, 5], 3), [1, 3, 5]);
    }
}
