//! Compares a trip's scans with those that other vehicles have brought into the map.

use std::collections::BTreeSet;

use super::trip_in_map::TripInMap;
use crate::calibration::{MapFit, MapScan, TripCalibration};
use crate::geometry::Pose2;
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{LidarId, NodeId};
use crate::mapping::Keyframe;
use crate::matching::ReferenceCloud;
use crate::pipeline::vehicles::{as_stated, base_from_stated};
use crate::scan::LaserScan;

/// Most scans of a trip that are compared; each costs a few milliseconds.
const SCANS_MAX: usize = 60;
/// Other vehicles' scans from within this distance show the same place, metres, …
const WITHIN_M: f64 = 3.0;
/// … from within this distance they show the same walls, …
const BESIDE_M: f64 = 1.0;
/// … and this many of the nearest are enough.
const AROUND_MAX: usize = 6;

/// The calibration of one of a trip's lidars, completed by the scale of its ranges relative to the reference
/// scans of other vehicles.
pub(super) fn beside_others(
    trip_in_map: &TripInMap<'_>,
    lidar: Option<&LidarId>,
    calibration: TripCalibration,
) -> TripCalibration {
    let placed = || {
        trip_in_map
            .map
            .keyframes()
            .iter()
            .zip(trip_in_map.map.graph().nodes())
    };
    let is_other = |keyframe: &Keyframe| {
        let whose = trip_in_map.vehicles.get(&keyframe.trip);
        keyframe.reference && whose.is_some_and(|vehicle| vehicle != trip_in_map.vehicle)
    };
    let others = placed().filter(|(keyframe, _)| keyframe.scan.is_some() && is_other(keyframe));
    let others: Vec<(Pose2, &Keyframe)> = others.map(|(k, node)| (node.pose, k)).collect();
    let own = placed().filter(|(keyframe, _)| {
        keyframe.trip == *trip_in_map.trip
            && keyframe.lidar.as_ref() == lidar
            && !keyframe.is_lost()
    });
    let own = own
        .filter_map(|(keyframe, node)| Some((keyframe, node.pose, around(&node.pose, &others)?)));
    let own: Vec<_> = own.collect();
    let every = own.len().div_ceil(SCANS_MAX).max(1);
    let compared = own.iter().step_by(every);
    let compared = compared.filter_map(|(keyframe, pose, around)| {
        let of_lidar = trip_in_map.corrections.of_lidar(lidar);
        let scan = as_stated(keyframe.scan.as_ref()?, &of_lidar)?;
        let stated = base_from_stated(keyframe, trip_in_map.corrections)?;
        let around = around.iter();
        let around = around.map(|(pose, other)| (*pose, other.points.as_slice()));
        Some((scan, pose.compose(&stated), ReferenceCloud::new(around)?))
    });
    let compared: Vec<(LaserScan, Pose2, ReferenceCloud)> = compared.collect();
    let scans = compared.iter().map(|(scan, map_from_base, map)| MapScan {
        scan,
        map,
        map_from_base: *map_from_base,
    });
    let fit = map_fit(trip_in_map, lidar, &others);
    calibration.beside_others(fit, &scans.collect::<Vec<_>>())
}

/// How many of the trip's keyframes are beside other vehicles' reference keyframes, and how many of these
/// have a loop closure with one. Keyframes that are not localised count at their start pose.
fn map_fit(
    trip_in_map: &TripInMap<'_>,
    lidar: Option<&LidarId>,
    others: &[(Pose2, &Keyframe)],
) -> MapFit {
    let graph = trip_in_map.map.graph();
    let others_nodes: BTreeSet<NodeId> = others.iter().map(|(_, other)| other.node).collect();
    let is_beside = |pose: &Pose2| {
        let away_m = |other: &Pose2| (other.translation() - pose.translation()).norm();
        others.iter().any(|(other, _)| away_m(other) <= BESIDE_M)
    };
    let is_closed = |node: NodeId| {
        graph.edges_at(node).any(|edge| {
            let ends = [edge.from, edge.to];
            edge.kind == EdgeKind::LoopClosure
                && edge.status == EdgeStatus::Active
                && ends.iter().any(|end| others_nodes.contains(end))
        })
    };
    let mut fit = MapFit { near: 0, closed: 0 };
    for (keyframe, node) in trip_in_map.map.keyframes().iter().zip(graph.nodes()) {
        let is_own = keyframe.trip == *trip_in_map.trip && keyframe.lidar.as_ref() == lidar;
        if is_own && is_beside(&node.pose) {
            fit.near += 1;
            fit.closed += u32::from(is_closed(keyframe.node));
        }
    }
    fit
}

/// The nearest of some keyframes to a pose; `None` if none is within [`WITHIN_M`].
fn around<'a>(
    pose: &Pose2,
    others: &[(Pose2, &'a Keyframe)],
) -> Option<Vec<(Pose2, &'a Keyframe)>> {
    let away_m = |other: &Pose2| (other.translation() - pose.translation()).norm();
    let near = others.iter().filter(|(other, _)| away_m(other) <= WITHIN_M);
    let mut near: Vec<_> = near.copied().collect();
    near.sort_by(|a, b| away_m(&a.0).total_cmp(&away_m(&b.0)));
    near.truncate(AROUND_MAX);
    (!near.is_empty()).then_some(near)
}
