//! Vehicles that were carried, and nobody noticed.
//!
//! Where corridors and doors repeat, the first scan after a vehicle was set down can be matched
//! with those before it, and one scan that contradicts another shows little: people pass, scans are
//! late. A few keyframes later it is plain: those before the step agree among themselves, those
//! after it do, and each contradicts those of the other side.

use super::closure::contradiction_share;
use super::drift::LOST_DRIFT_M;
use super::extend::Extension;
use super::route_map::{RouteMap, Weighting};
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::EdgeId;

/// So many keyframes before a step are compared with as many after it …
const SIDE: usize = 4;
/// … no more places in the trip apart than this.
const PLACES_APART_MAX: usize = 3;
/// Across the step every comparison must contradict by this share of the points, …
const CONTRADICTION_SHARE_MIN: f64 = 0.1;
/// … and by so many times as much as any on one side of it.
const CONTRAST_MIN: f64 = 4.0;

impl RouteMap {
    /// Takes a trip that ends at `index` for lost since the step before its last [`SIDE`]
    /// keyframes, if it was carried there: what tied them to the map is quarantined.
    pub(super) fn lose_if_carried(&mut self, index: usize, added: &mut Extension) {
        let Some(since) = self.set_down(index) else {
            return;
        };
        let is_driven = |edge: usize| {
            let (from, to) = self.graph.ends()[edge];
            let is_odometry = self.graph.edges()[edge].kind == EdgeKind::Odometry;
            is_odometry && since.contains(&from) && since.contains(&to)
        };
        let ties = since.iter().flat_map(|&k| self.graph.incident(k));
        let ties = ties.filter(|&&edge| !is_driven(edge));
        let ties: Vec<(EdgeId, EdgeStatus)> = ties
            .map(|&edge| (self.graph.edges()[edge].id, EdgeStatus::Quarantined))
            .collect();
        self.restate_edges(&ties);
        added
            .closures
            .retain(|closure| !ties.iter().any(|(edge, _)| *edge == closure.edge));
        for &k in &since {
            let keyframe = &mut self.keyframes[k];
            (keyframe.drift_m, keyframe.reference) = (LOST_DRIFT_M, false);
        }
    }

    /// The keyframes of a trip since it was set down; `None` if it was not just [`SIDE`] keyframes ago.
    fn set_down(&self, index: usize) -> Option<Vec<usize>> {
        let trip = self.trip_up_to(index);
        let newest = &trip[trip.len().checked_sub(2 * SIDE)?..];
        let was_lost = newest.iter().any(|&k| self.is_lost(k));
        if self.weighting == Weighting::Paper || was_lost {
            return None;
        }
        let share = |a: usize, b: usize| {
            let nodes = self.graph.nodes();
            let [before, after] = [newest[a], newest[b]];
            let pose = nodes[before].pose.between(&nodes[after].pose);
            contradiction_share(&self.keyframes[before], &self.keyframes[after], &pose)
        };
        let mut across_min = share(SIDE - 1, SIDE)?;
        if across_min < CONTRADICTION_SHARE_MIN {
            return None;
        }
        let mut aside_max: f64 = 0.0;
        for a in 0..newest.len() {
            for b in a + 1..newest.len().min(a + 1 + PLACES_APART_MAX) {
                match a < SIDE && b >= SIDE {
                    true => across_min = across_min.min(share(a, b)?),
                    false => aside_max = aside_max.max(share(a, b)?),
                }
            }
        }
        let was_carried = across_min >= CONTRADICTION_SHARE_MIN.max(CONTRAST_MIN * aside_max);
        was_carried.then(|| newest[SIDE..].to_vec())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::drive::{Drive, DriveScan, InitialPose};
    use super::*;
    use crate::geometry::{Pose2, Vector2};
    use crate::graph::PoseGraph;
    use crate::ids::{StampNs, TripId};
    use crate::scan::{LaserScan, Lidar};
    use crate::sim::{Shape, World};

    const STEP_M: f64 = 0.4;

    /// A corridor 1.6 m wide between rooms 5 m deep, a door every 3 m, and in some of the rooms
    /// something that the others do not have.
    fn corridor() -> World {
        let box_of = |x: f64, y: f64, length: f64, width: f64| {
            Shape::rectangle(&Pose2::new(x, y, 0.0), length, width)
        };
        let walls = (-12..=12).flat_map(|k| {
            let x = 3.0 * f64::from(k);
            [box_of(x, 0.85, 2.0, 0.1), box_of(x + 1.3, -0.85, 2.0, 0.1)]
        });
        let ends = [box_of(0.0, 6.0, 80.0, 0.1), box_of(0.0, -6.0, 80.0, 0.1)];
        let inside = [
            box_of(-10.5, 2.5, 1.5, 0.8),
            box_of(-4.0, -2.0, 0.6, 0.6),
            box_of(8.0, 3.0, 0.5, 2.0),
            box_of(12.0, -3.0, 2.5, 0.5),
            box_of(16.5, 2.0, 0.8, 0.8),
        ];
        World::new(walls.chain(ends).chain(inside))
    }

    fn scan_from(world: &World, from: &Pose2) -> LaserScan {
        let lidar = Arc::new(Lidar {
            angle_min_rad: -3.1,
            angle_increment_rad: 0.0172,
            range_min_m: 0.05,
            range_max_m: 20.0,
            mount: Pose2::IDENTITY,
            range_sigma_m: 0.01,
            band: None,
        });
        let ranges = (0..360).map(|beam| {
            let (sin, cos) = (from.theta + lidar.beam_angle_rad(beam)).sin_cos();
            let hit = world.cast(&from.translation(), &Vector2::new(cos, sin));
            hit.map(|hit| hit.range_m + 0.01 * (beam as f64 * beam as f64).sin())
        });
        LaserScan::new(lidar.clone(), ranges.collect::<Vec<_>>()).unwrap()
    }

    /// A trip along the corridor that is at `xs_m`, of which its odometry says a step each.
    fn along(world: &World, trip: &str, start_s: i64, xs_m: &[f64]) -> Drive {
        let scans = xs_m.iter().enumerate().map(|(k, &x)| DriveScan {
            beam_interval_s: 0.0,
            lidar: Default::default(),
            stamp: StampNs(1_000_000_000 * (start_s + k as i64)),
            odom_from_base: Pose2::new(STEP_M * k as f64, 0.0, 0.0),
            scan: scan_from(world, &Pose2::new(x, 0.0, 0.0)),
        });
        Drive {
            wheels: Default::default(),
            trip: TripId::new(trip).unwrap(),
            initial_pose: Some(InitialPose {
                pose: Pose2::new(xs_m[0], 0.0, 0.0),
                sigma_xy_m: 0.01,
                sigma_theta_rad: 0.005,
            }),
            scans: scans.collect(),
        }
    }

    fn way(from_m: f64, scans: usize) -> impl Iterator<Item = f64> {
        (0..scans).map(move |k| from_m + STEP_M * k as f64)
    }

    fn active(graph: &PoseGraph) -> usize {
        let edges = graph.edges().iter();
        edges
            .filter(|edge| edge.status == EdgeStatus::Active)
            .count()
    }

    #[test]
    fn a_vehicle_that_is_set_down_at_a_door_like_the_one_before_is_not_taken_to_have_driven_on() {
        let world = corridor();
        let mut map = RouteMap::new(Weighting::Robust);
        let sound = along(&world, "sound", 0, &way(-12.0, 75).collect::<Vec<_>>());
        map.extend(&sound).unwrap();
        let (poses, edges) = (map.graph.nodes().to_vec(), active(&map.graph));
        // Three doors on, after 12 scans.
        let xs_m: Vec<f64> = way(-9.0, 12).chain(way(4.8, 30)).collect();
        map.extend(&along(&world, "carried", 10_000, &xs_m))
            .unwrap();
        for (k, keyframe) in map.keyframes.iter().enumerate() {
            if keyframe.trip.as_str() == "carried" && !keyframe.is_lost() {
                let scan = (keyframe.stamp.0 / 1_000_000_000 - 10_000) as usize;
                let off_m = (map.graph.nodes()[k].pose.x - xs_m[scan]).abs();
                assert!(off_m < 0.1, "scan {scan}: {off_m}");
            }
        }
        for (then, now) in poses.iter().zip(map.graph.nodes()) {
            let moved_m = (then.pose.translation() - now.pose.translation()).norm();
            assert!(moved_m < 0.02, "{moved_m}");
        }
        assert!(active(&map.graph) > edges);
    }

    #[test]
    fn one_who_drives_on_is_not_lost_though_things_move_past() {
        let (before, after) = (corridor(), {
            let shape = Shape::rectangle(&Pose2::new(3.0, 0.0, 0.0), 0.4, 0.4);
            World::new([shape])
        });
        let mut map = RouteMap::new(Weighting::Robust);
        let xs_m: Vec<f64> = way(-12.0, 60).collect();
        let mut drive = along(&before, "passed", 0, &xs_m);
        // Something stands in the corridor in three scans, and is gone.
        for k in 28..31 {
            let from = Pose2::new(xs_m[k], 0.0, 0.0);
            let near = scan_from(&after, &from);
            let ranges = drive.scans[k].scan.ranges_m().zip(near.ranges_m());
            let ranges: Vec<Option<f64>> = ranges
                .map(|(far, near)| match (far, near) {
                    (Some(far), Some(near)) => Some(far.min(near)),
                    (far, near) => near.or(far),
                })
                .collect();
            drive.scans[k].scan = LaserScan::new(near.lidar().clone(), ranges).unwrap();
        }
        map.extend(&drive).unwrap();
        assert!(map.keyframes.iter().all(|keyframe| !keyframe.is_lost()));
        assert!(
            map.graph
                .edges()
                .iter()
                .all(|edge| edge.status == EdgeStatus::Active)
        );
    }
}
