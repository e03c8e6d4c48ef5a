//! Vehicles that were carried, and nobody noticed.
//!
//! Where corridors and doors repeat, the first scan after a vehicle was set down can be matched
//! with those before it, and one scan that contradicts another shows little: people pass, scans are
//! late. A few keyframes later it is plain: those before the step agree among themselves, those
//! after it do, and each contradicts those of the other side.

use super::closure::{DEPTH_TOLERANCE, contradiction_share};
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
    pub(super) fn lose_if_carried(&mut self, index: usize) {
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
        self.lose(&since);
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
            contradiction_share(
                &self.keyframes[before],
                &self.keyframes[after],
                &pose,
                &DEPTH_TOLERANCE,
            )
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

    use super::super::testing::{BEAMS, EVERY_S, SCANS, drive_through, rooms, truth};
    use super::*;
    use crate::observation::testing::{World, all_round};

    const START_S: f64 = 1e4;
    const LOADED: i64 = 60;

    /// The map of a sound trip and of one that starts [`START_S`] later and sees another world from
    /// its [`LOADED`]th scan on, and whether that was lost.
    fn driven_with(world: &World) -> (RouteMap, bool) {
        let mut map = RouteMap::new(Weighting::Robust);
        let known = drive_through(&rooms(), "known", 0.0, 0..SCANS, |_, motion| motion);
        map.extend(&known).unwrap();
        let mut later = drive_through(&rooms(), "loaded", START_S, 0..SCANS, |_, motion| motion);
        let lidar = Arc::new(all_round(BEAMS));
        for k in LOADED..SCANS {
            later.scans[k as usize].scan = world.scan(&lidar, BEAMS, &truth(k), || 0.0);
        }
        let mut was_lost = false;
        for scan in later.scans.clone() {
            later.scans = vec![scan];
            map.extend(&later).unwrap();
            was_lost |= map.keyframes.iter().any(|keyframe| keyframe.is_lost());
        }
        (map, was_lost)
    }

    fn assert_found(map: &RouteMap) {
        for (keyframe, node) in map.keyframes.iter().zip(map.graph.nodes()) {
            let start_s = if keyframe.trip.as_str() == "known" {
                0.0
            } else {
                START_S
            };
            let scan = ((keyframe.stamp.seconds() - start_s) / EVERY_S).round() as i64;
            let off_m = (node.pose.translation() - truth(scan).translation()).norm();
            assert!(off_m < 0.05 && !keyframe.is_lost(), "{scan}: {off_m}");
        }
    }

    #[test]
    fn a_vehicle_beside_which_a_load_is_set_down_is_found_where_it_is() {
        let beside = truth(LOADED);
        let low = [beside.x - 0.8, beside.y - 1.6];
        let world = rooms().with_rectangle(low, [low[0] + 1.6, low[1] + 0.8]);
        let (map, was_lost) = driven_with(&world);
        assert!(was_lost, "the load is too small to be mistaken");
        assert_found(&map);
    }

    #[test]
    fn a_vehicle_whose_load_tilts_its_lidar_is_not_lost_for_good() {
        // At another height what leans and what stands on a foot is elsewhere.
        let other_height = World::default()
            .with_rectangle([0.0, 0.0], [14.0, 7.3])
            .with_side([7.0, 0.0], [7.0, 3.0])
            .with_side([7.0, 4.5], [7.0, 7.3])
            .with_rectangle([1.3, 5.2], [2.5, 6.4])
            .with_rectangle([4.6, 0.3], [5.2, 1.3])
            .with_rectangle([9.0, 0.6], [11.5, 0.8])
            .with_rectangle([12.2, 5.1], [13.1, 6.9]);
        let (map, was_lost) = driven_with(&other_height);
        assert!(was_lost, "the two heights look too much alike");
        assert_found(&map);
    }

    #[test]
    fn a_vehicle_past_which_something_moves_has_not_been_carried() {
        let mut passed = drive_through(&rooms(), "passed", 0.0, 0..SCANS, |_, motion| motion);
        let lidar = Arc::new(all_round(BEAMS));
        for k in 60..70 {
            let there = truth(k);
            // Half a metre beside it, as long as it is passed.
            let low = [there.x - 1.0, there.y + 0.5];
            let world = rooms().with_rectangle(low, [low[0] + 2.0, low[1] + 0.4]);
            passed.scans[k as usize].scan = world.scan(&lidar, BEAMS, &there, || 0.0);
        }
        let mut map = RouteMap::new(Weighting::Robust);
        map.extend(&passed).unwrap();
        assert!(map.keyframes.iter().all(|keyframe| !keyframe.is_lost()));
        let mut edges = map.graph.edges().iter();
        assert!(edges.all(|edge| edge.status == EdgeStatus::Active));
    }
}
