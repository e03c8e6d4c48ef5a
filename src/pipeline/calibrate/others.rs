//! What a trip's scans say beside those that other vehicles have brought into the map.

use std::collections::BTreeSet;

use super::asked::Asked;
use crate::calibration::{MapFit, MapScan, TripCalibration};
use crate::geometry::Pose2;
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{LidarId, NodeId};
use crate::mapping::Keyframe;
use crate::matching::ReferenceCloud;
use crate::pipeline::vehicles::{as_stated, base_from_stated};
use crate::scan::LaserScan;

/// So many of a trip's scans are compared. Each costs a few milliseconds.
const SCANS_MAX: usize = 60;
/// Other vehicles' scans from no farther than this show the same place, metres, …
const WITHIN_M: f64 = 3.0;
/// … from no farther than this they show the same walls, …
const BESIDE_M: f64 = 1.0;
/// … and so many of them, the nearest, are enough.
const AROUND_MAX: usize = 6;

/// The trip's word on one of its lidars, with what the map's reference scans of other vehicles say of
/// its ranges.
pub(super) fn beside_others(
    asked: &Asked<'_>,
    lidar: Option<&LidarId>,
    calibration: TripCalibration,
) -> TripCalibration {
    let placed = || asked.map.keyframes().iter().zip(asked.map.graph().nodes());
    let is_other = |keyframe: &Keyframe| {
        let whose = asked.vehicles.get(&keyframe.trip);
        keyframe.reference && whose.is_some_and(|vehicle| vehicle != asked.vehicle)
    };
    let others = placed().filter(|(keyframe, _)| keyframe.scan.is_some() && is_other(keyframe));
    let others: Vec<(Pose2, &Keyframe)> = others.map(|(k, node)| (node.pose, k)).collect();
    let own = placed().filter(|(keyframe, _)| {
        keyframe.trip == *asked.trip && keyframe.lidar.as_ref() == lidar && !keyframe.is_lost()
    });
    let own = own
        .filter_map(|(keyframe, node)| Some((keyframe, node.pose, around(&node.pose, &others)?)));
    let own: Vec<_> = own.collect();
    let every = own.len().div_ceil(SCANS_MAX).max(1);
    let compared = own.iter().step_by(every);
    let compared = compared.filter_map(|(keyframe, pose, around)| {
        let of_lidar = asked.corrections.of_lidar(lidar);
        let scan = as_stated(keyframe.scan.as_ref()?, &of_lidar)?;
        let stated = base_from_stated(keyframe, asked.corrections)?;
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
    let fit = map_fit(asked, lidar, &others);
    calibration.beside_others(fit, &scans.collect::<Vec<_>>())
}

/// How many of the trip's keyframes stand beside other vehicles' reference keyframes, and how many of
/// them have a loop closure with one. Keyframes that are lost count where the start pose puts them.
fn map_fit(asked: &Asked<'_>, lidar: Option<&LidarId>, others: &[(Pose2, &Keyframe)]) -> MapFit {
    let graph = asked.map.graph();
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
    for (keyframe, node) in asked.map.keyframes().iter().zip(graph.nodes()) {
        let is_own = keyframe.trip == *asked.trip && keyframe.lidar.as_ref() == lidar;
        if is_own && is_beside(&node.pose) {
            fit.near += 1;
            fit.closed += u32::from(is_closed(keyframe.node));
        }
    }
    fit
}

/// The nearest of some keyframes to a pose; `None` if there are none near.
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
