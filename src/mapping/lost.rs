//! Trips that nobody knows how they went on: carried, or with odometry that broke.
//!
//! Where neither the odometry nor the scans say how a trip came from one keyframe to the next, no
//! edge joins the two. What follows is a segment of its own: it observes nothing, nothing is tied
//! to it, and it bends nothing, until enough of its scans together say where it is.
//!
//! A corridor looks the same a few metres on, and a fault may pass unseen. Then the trip drives
//! past what the map knows and is tied to none of it: it went astray, and is searched for too.

use super::anchor;
use super::confirmation::{BRIEF, Comparison, STRICT, compare};
use super::drift::{LOST_DRIFT_M, slack_after};
use super::expected::EXPECTED_SHARE_MIN;
use super::extend::Extension;
use super::front_end::Motion;
use super::odometry::OdometryMotion;
use super::partners::{self, PARTNER_DISTANCE_MAX_M, Placed};
use super::route_map::{RouteMap, Weighting};
use crate::change::Layer;
use crate::geometry::Pose2;
use crate::graph::{Edge, EdgeKind, EdgeStatus, GraphError};
use crate::ids::EdgeId;

/// So many of a segment's newest keyframes say where it is.
const KEYFRAMES_MAX: usize = 24;
/// A segment of fewer must fit nearly everywhere.
const BRIEF_KEYFRAMES: usize = 12;
/// A segment is searched for when it has grown by this share: sparingly, …
const SEARCH_GROWTH: f64 = 0.25;
/// … but at least after so many keyframes.
const SEARCH_STEP_MAX: usize = 40;
/// Fewer keyframes fit in many places.
const KEYFRAMES_MIN: usize = 8;
/// A trip that has driven so far past what the map knows may have gone astray, metres.
const ASTRAY_DRIFT_M: f64 = 12.0;
/// It was right up to where so many of its keyframes, one after the other, do not agree.
const DISAGREEING_MIN: usize = 3;

impl RouteMap {
    /// Whether nothing tells where the keyframe at a place of the trip is.
    pub(super) fn is_lost(&self, k: usize) -> bool {
        self.keyframes[k].is_lost()
    }

    /// Looks for the lost segment that ends at `index`; where it is found it is moved there, as it
    /// is, and its keyframes are tied to the map.
    pub(super) fn find_segment(
        &mut self,
        index: usize,
        added: &mut Extension,
    ) -> Result<(), GraphError> {
        let segment = self.lost_segment(index);
        if !is_search_due(segment.len()) {
            return Ok(());
        }
        let newest = &segment[segment.len().saturating_sub(KEYFRAMES_MAX)..];
        let was_cut = self.was_cut_before(segment[0]);
        let is_expected = match was_cut {
            true => self.agree_as_placed(newest),
            false => self.are_where_expected(newest),
        };
        if is_expected {
            return self.rejoin(&segment, added);
        }
        let own: Vec<Placed<'_>> = newest.iter().map(|&k| self.placed(k)).collect();
        let layer = self.keyframes[index].layer();
        let confirmation = match newest.len() < BRIEF_KEYFRAMES {
            true => &BRIEF,
            false => &STRICT,
        };
        let located = anchor::locate(&self.placed_references(layer), &own, confirmation);
        let is_long = newest.len() == KEYFRAMES_MAX;
        match located {
            Ok(map_from_own) => self.move_segment(&segment, &map_from_own, added),
            // Not carried, then: the place has changed, or the height at which the lidar sees it.
            Err(error)
                if was_cut
                    && is_long
                    && (self.are_where_expected(newest) || self.are_best_here(newest, &error)) =>
            {
                self.rejoin(&segment, added)
            }
            Err(_) => Ok(()),
        }
    }

    /// Takes a lost segment for what its odometry says: ties it to what the trip drove before, and
    /// to the map.
    fn rejoin(&mut self, segment: &[usize], added: &mut Extension) -> Result<(), GraphError> {
        for &k in segment {
            self.keyframes[k].drift_m = 0.0;
        }
        let Some(&first) = segment.first() else {
            return Ok(());
        };
        if let [.., before, _] = self.trip_up_to(first) {
            let (last, new) = (&self.keyframes[*before], &self.keyframes[first]);
            let odometry = OdometryMotion::told(&last.odom_from_base.between(&new.odom_from_base));
            let motion = Motion {
                measurement: odometry.motion,
                information: odometry.sigmas.information(),
                matched: false,
            };
            self.add_odometry(last.node, first, &motion, added)?;
        }
        for &k in segment {
            self.close_loops(k, added)?;
        }
        Ok(())
    }

    /// Looks everywhere for a trip that ends at `index` and has driven past what the map knows.
    /// Where it is found somewhere else, it is cut off where it went astray and moved there.
    pub(super) fn find_astray(
        &mut self,
        index: usize,
        added: &mut Extension,
    ) -> Result<(), GraphError> {
        if !self.may_be_astray(index) {
            return Ok(());
        }
        let untied = self.trip_up_to(index).iter().rev();
        let untied: Vec<usize> = untied
            .take_while(|k| self.keyframes[**k].drift_m > 0.0)
            .copied()
            .collect();
        let references = self.placed_references(self.keyframes[index].layer());
        let others: Vec<Placed<'_>> = references
            .into_iter()
            .filter(|r| {
                !untied
                    .iter()
                    .any(|&k| self.keyframes[k].node == r.keyframe.node)
            })
            .collect();
        let newest: Vec<usize> = untied.iter().take(KEYFRAMES_MAX).copied().collect();
        let own: Vec<Placed<'_>> = newest.iter().map(|&k| self.placed(k)).collect();
        let Ok(map_from_own) = anchor::locate(&others, &own, &STRICT) else {
            let was_never_tied = untied.len() == self.trip_up_to(index).len();
            let share = was_never_tied
                .then(|| self.fitting_share(&newest, others))
                .flatten();
            if share.is_some_and(|share| share < EXPECTED_SHARE_MIN) {
                // It was said to start where nothing looks like what it sees.
                self.lose(&untied);
            }
            return Ok(());
        };
        let pose = self.graph.nodes()[index].pose;
        let moved = pose.between(&map_from_own.compose(&pose));
        let slack = slack_after(self.keyframes[index].drift_m);
        if moved.translation().norm() <= slack.distance_m && moved.theta.abs() <= slack.turn_rad {
            return Ok(());
        }
        let mut segment = Vec::new();
        let (mut disagreeing, mut right) = (0, 0);
        for &k in &untied {
            segment.push(k);
            match compare(&others, &self.placed(k), &map_from_own, &STRICT) {
                Some(Comparison::Agrees(_)) => (disagreeing, right) = (0, segment.len()),
                Some(Comparison::Differs) | None => disagreeing += 1,
            }
            if disagreeing >= DISAGREEING_MIN {
                break;
            }
        }
        segment.truncate(right);
        segment.reverse();
        self.cut_before(&segment);
        self.move_segment(&segment, &map_from_own, added)
    }

    /// Takes keyframes for lost: nothing is tied to them any more.
    pub(super) fn lose(&mut self, keyframes: &[usize]) {
        for &k in keyframes {
            let keyframe = &mut self.keyframes[k];
            (keyframe.drift_m, keyframe.reference) = (LOST_DRIFT_M, false);
        }
    }

    /// Whether the odometry that led a trip to a keyframe is not believed.
    fn was_cut_before(&self, first: usize) -> bool {
        let mut led = self.odometry_to(first);
        led.any(|edge| edge.status == EdgeStatus::Quarantined)
    }

    /// The odometry edges that end at a keyframe.
    fn odometry_to(&self, k: usize) -> impl Iterator<Item = &Edge> {
        let incident = self.graph.incident(k).iter();
        let to = incident.filter(move |&&edge| self.graph.ends()[edge].1 == k);
        let to = to.map(|&edge| &self.graph.edges()[edge]);
        to.filter(|edge| edge.kind == EdgeKind::Odometry)
    }

    fn may_be_astray(&self, index: usize) -> bool {
        let drift_m = self.keyframes[index].drift_m;
        let before_m = match self.trip_up_to(index) {
            [.., before, _] => self.keyframes[*before].drift_m,
            _ => return false,
        };
        let number = |drift_m: f64| (drift_m / ASTRAY_DRIFT_M).ln() / SEARCH_GROWTH.ln_1p();
        if drift_m < ASTRAY_DRIFT_M || number(before_m).floor() == number(drift_m).floor() {
            return false;
        }
        let new = self.placed(index);
        let nearby = self.references_near(index, &new.pose, PARTNER_DISTANCE_MAX_M);
        !partners::choose(&new, &nearby).is_empty()
    }

    /// Quarantines the odometry edges that tie a segment to what the trip drove before.
    fn cut_before(&mut self, segment: &[usize]) {
        let Some(&first) = segment.first() else {
            return;
        };
        let ties: Vec<EdgeId> = self.odometry_to(first).map(|edge| edge.id).collect();
        for edge in ties {
            self.graph.set_edge_status(edge, EdgeStatus::Quarantined);
        }
    }

    /// Moves keyframes that hang together and on nothing else, and ties them to the map.
    fn move_segment(
        &mut self,
        segment: &[usize],
        map_from_own: &Pose2,
        added: &mut Extension,
    ) -> Result<(), GraphError> {
        for &k in segment {
            let pose = map_from_own.compose(&self.graph.nodes()[k].pose);
            self.graph.set_pose_at(k, pose);
            let keyframe = &mut self.keyframes[k];
            (keyframe.drift_m, keyframe.reference) = (0.0, false);
        }
        for &k in segment {
            self.close_loops(k, added)?;
        }
        Ok(())
    }

    /// The keyframes of a trip up to the one at `index` that were lost together: since then no step
    /// was lost again.
    pub(super) fn lost_segment(&self, index: usize) -> Vec<usize> {
        let trip = self.trip_up_to(index).iter().rev();
        let mut segment: Vec<usize> = Vec::new();
        for &k in trip.take_while(|k| self.is_lost(**k)) {
            if segment
                .last()
                .is_some_and(|after| !self.is_joined(k, *after))
            {
                break;
            }
            segment.push(k);
        }
        segment.reverse();
        segment
    }

    /// Whether the odometry of a trip leads from one of its keyframes to the next.
    fn is_joined(&self, before: usize, after: usize) -> bool {
        self.graph.incident(after).iter().any(|&edge| {
            let Edge { kind, status, .. } = self.graph.edges()[edge];
            self.graph.ends()[edge] == (before, after)
                && kind == EdgeKind::Odometry
                && status == EdgeStatus::Active
        })
    }

    /// What trips of a layer can be localised by.
    pub(super) fn placed_references(&self, layer: Layer) -> Vec<Placed<'_>> {
        let all = (0..self.keyframes.len()).filter(|&k| self.is_reference_with_scan(k));
        self.of_layer_first(layer, all.map(|k| self.placed(k)).collect())
    }

    /// Those of a layer; all of them if none is. Walls and posts stand in every height band, so the
    /// first trip of a band is tied to what the map has of others; from then on bands are matched
    /// with their like. Never where all points are matched: what two bands see differently would
    /// look like a change.
    pub(super) fn of_layer_first<'a>(
        &self,
        layer: Layer,
        placed: Vec<Placed<'a>>,
    ) -> Vec<Placed<'a>> {
        let is_like = |placed: &Placed<'a>| placed.keyframe.layer() == layer;
        let crosses = self.weighting == Weighting::Robust && !placed.iter().any(is_like);
        placed
            .into_iter()
            .filter(|p| crosses || is_like(p))
            .collect()
    }
}

fn is_search_due(keyframes: usize) -> bool {
    let number = |keyframes: usize| (keyframes as f64).ln() / SEARCH_GROWTH.ln_1p();
    keyframes >= KEYFRAMES_MIN
        && (number(keyframes).floor() != number(keyframes - 1).floor()
            || keyframes.is_multiple_of(SEARCH_STEP_MAX))
}

impl super::keyframe::Keyframe {
    /// Whether nothing tells where it is.
    pub fn is_lost(&self) -> bool {
        self.drift_m >= LOST_DRIFT_M
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::drive::{Drive, DriveScan};
    use super::super::testing::{BEAMS, EVERY_S, SCANS, drive_through, rooms, truth};
    use super::*;
    use crate::geometry::angle_difference_rad;
    use crate::ids::StampNs;
    use crate::observation::testing::all_round;

    /// Through both rooms.
    fn drive(
        trip: &str,
        start_s: f64,
        taken: impl Iterator<Item = i64>,
        reported: impl Fn(usize, Pose2) -> Pose2,
    ) -> Drive {
        drive_through(&rooms(), trip, start_s, taken, reported)
    }

    fn known() -> RouteMap {
        let mut map = RouteMap::new(Weighting::Robust);
        let sound = drive("known", 0.0, 0..SCANS, |_, motion| motion);
        map.extend(&sound).unwrap();
        map
    }

    /// How far each keyframe of a trip is from the truth, metres; one that is turned is far.
    fn errors_m(map: &RouteMap, trip: &str, start_s: f64, taken: &[i64]) -> Vec<f64> {
        let keyframes = map.keyframes().iter().zip(map.graph().nodes());
        let of_trip = keyframes.filter(|(keyframe, _)| keyframe.trip.as_str() == trip);
        let error_m = of_trip.map(|(keyframe, node)| {
            let k = ((keyframe.stamp.seconds() - start_s) / EVERY_S).round();
            let there = truth(taken[k as usize]);
            let turned_rad = angle_difference_rad(node.pose.theta, there.theta);
            (node.pose.translation() - there.translation()).norm() + 10.0 * turned_rad
        });
        error_m.collect()
    }

    #[test]
    fn a_step_that_odometry_made_up_is_not_taken() {
        let wrong_turn = Pose2::new(0.0, 0.0, 1.4);
        let wrong_way = Pose2::new(5.0, 0.0, 0.0);
        let afresh = Pose2::new(-3.0, 8.0, 2.0);
        for made_up in [wrong_turn, wrong_way, afresh] {
            let mut map = RouteMap::new(Weighting::Robust);
            let taken: Vec<i64> = (0..SCANS).collect();
            let fault = drive("faulty", 0.0, taken.iter().copied(), |k, motion| match k {
                80 => made_up.compose(&motion),
                _ => motion,
            });
            map.extend(&fault).unwrap();
            let worst_m = errors_m(&map, "faulty", 0.0, &taken);
            let worst_m = worst_m.into_iter().fold(0.0, f64::max);
            assert!(worst_m < 0.1, "{made_up:?}: {worst_m}");
            assert!(map.keyframes().iter().all(|keyframe| !keyframe.is_lost()));
        }
    }

    #[test]
    fn wheels_that_slip_are_told_by_what_is_out_of_place() {
        let mut map = RouteMap::new(Weighting::Robust);
        let taken: Vec<i64> = (0..SCANS).collect();
        let slip = drive("slips", 0.0, taken.iter().copied(), |k, motion| match k {
            60..80 => Pose2::new(3.0 * motion.x, 3.0 * motion.y, motion.theta),
            _ => motion,
        });
        map.extend(&slip).unwrap();
        let worst_m = errors_m(&map, "slips", 0.0, &taken);
        let worst_m = worst_m.into_iter().fold(0.0, f64::max);
        assert!(worst_m < 0.1, "{worst_m}");
        assert!(map.keyframes().iter().all(|keyframe| !keyframe.is_lost()));
    }

    #[test]
    fn a_vehicle_whose_odometry_reports_nothing_is_followed_by_its_scans() {
        let mut map = RouteMap::new(Weighting::Robust);
        let taken: Vec<i64> = (0..SCANS).collect();
        let silent = drive("silent", 0.0, taken.iter().copied(), |_, _| Pose2::IDENTITY);
        map.extend(&silent).unwrap();
        let errors_m = errors_m(&map, "silent", 0.0, &taken);
        assert!(errors_m.len() > 30, "{}", errors_m.len());
        let worst_m = errors_m.into_iter().fold(0.0, f64::max);
        assert!(worst_m < 0.15, "{worst_m}");
    }

    #[test]
    fn a_vehicle_that_stands_by_its_wheels_stays_whatever_passes() {
        let mut passed = drive("stands", 0.0, 0..60, |_, motion| motion);
        let (lidar, there) = (Arc::new(all_round(BEAMS)), truth(59));
        let last = passed.scans[59].clone();
        let passing = (1..=30).map(|k| {
            // A long wall of boxes, half a metre beside it, at 1 m/s.
            let ahead = there.x - 8.0 + 0.2 * k as f64;
            let [low, high] = [there.y + 0.5, there.y + 0.9];
            let world = (0..6).fold(rooms(), |world, n| {
                let x = ahead + 1.3 * f64::from(n);
                world.with_rectangle([x, low], [x + 1.0, high])
            });
            DriveScan {
                stamp: StampNs(last.stamp.0 + (1e9 * EVERY_S) as i64 * k),
                scan: world.scan(&lidar, BEAMS, &there, || 0.0),
                ..last.clone()
            }
        });
        passed.scans.extend(passing);
        let mut map = RouteMap::new(Weighting::Robust);
        map.extend(&passed).unwrap();
        let newest = map.keyframes().last().unwrap();
        assert!(newest.stamp <= last.stamp && !newest.is_lost());
    }

    #[test]
    fn a_carried_vehicle_is_on_its_own_until_its_scans_say_where_it_is() {
        let mut map = known();
        let before = map.graph().nodes().to_vec();
        // From the end of one room into the other, with the odometry running.
        let taken: Vec<i64> = (0..40).chain(110..SCANS).collect();
        let carried = drive("carried", 1e4, taken.iter().copied(), |k, motion| match k {
            40 => Pose2::new(0.1, 0.0, 0.0),
            _ => motion,
        });
        let (mut first, mut rest) = (carried.clone(), carried);
        rest.initial_pose = None;
        rest.scans.drain(..49);
        first.scans.truncate(49);
        map.extend(&first).unwrap();
        let newest = map.keyframes().last().unwrap();
        assert!(newest.is_lost() && !newest.reference);
        map.extend(&rest).unwrap();
        assert!(map.keyframes().iter().all(|keyframe| !keyframe.is_lost()));
        let worst_m = errors_m(&map, "carried", 1e4, &taken);
        let worst_m = worst_m.into_iter().fold(0.0, f64::max);
        assert!(worst_m < 0.1, "{worst_m}");
        // Nothing of what was known before is bent.
        for (then, now) in before.iter().zip(map.graph().nodes()) {
            let moved_m = (then.pose.translation() - now.pose.translation()).norm();
            assert!(moved_m < 0.02, "{moved_m}");
        }
    }

    #[test]
    fn searches_become_rarer_up_to_a_step() {
        let due: Vec<usize> = (0..400).filter(|n| is_search_due(*n)).collect();
        assert_eq!(due[0], KEYFRAMES_MIN);
        assert!(due.len() < 40, "{due:?}");
        assert!(due.windows(2).all(|w| w[1] - w[0] <= SEARCH_STEP_MAX));
    }
}
