//! How a trip came from its last keyframe to its next scan, where its odometry may be wrong.
//!
//! Wheels slip, an encoder jumps, a driver starts its odometry anew, a robot is carried. The scans
//! show it: what one saw as free is full in the next. Then the scans are believed without the
//! odometry, and where they say nothing either, nobody knows how the trip went on.

use super::closure::{self, contradiction_share};
use super::front_end::{Motion, match_alone, match_from, measure_motion};
use super::keyframe::Keyframe;
use super::local_map::{LocalCloud, LocalMap};
use super::odometry::OdometryMotion;
use crate::geometry::Pose2;
use crate::matching::DepthTolerance;

/// By how much the depths of a step's scans may differ: more where beams graze a surface, since in
/// narrow places that looks like a step which went wrong.
const DEPTH_TOLERANCE: DepthTolerance = DepthTolerance {
    is_across: true,
    ..closure::DEPTH_TOLERANCE
};
/// Two scans of a step are not where the odometry has them if more than this share of one's points
/// lies in the other's free space …
const CONTRADICTION_SHARE_MAX: f64 = 0.35;
/// … and not where a match has them if more than this does.
const CONTRADICTION_SHARE_MAX_IF_MATCHED: f64 = 0.5;
/// Wheels may have slipped if more than this share does, …
const DOUBTED_SHARE: f64 = 0.04;
/// … which is more than so many points of the scan that has fewer, and did …
const DOUBTED_POINTS: f64 = 8.0;
/// … if another way along theirs leaves less, no more than this part of it, …
const SLIPPED_PART_MAX: f64 = 0.3;
/// … and ends as far as this from where they say, metres.
const SLIPPED_MIN_M: f64 = 0.2;
/// Such ways are looked for around these parts of theirs, where less contradicts than with the whole.
const PARTS_OF_WAY: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.5];
/// Odometry is abrupt if it is faster by this factor than the trip has been, …
const ABRUPT_FACTOR: f64 = 3.0;
/// … and faster than this, m/s …
const ABRUPT_M_PER_S: f64 = 3.0;
/// … or rad/s; …
const ABRUPT_RAD_PER_S: f64 = 3.0;
/// … for a trip that has just begun, than this, m/s …
const UNHEARD_OF_M_PER_S: f64 = 40.0;
/// … or rad/s.
const UNHEARD_OF_RAD_PER_S: f64 = 10.0;
/// Where a step is longer than this, metres, and than the lidar sees, nothing that was seen before it
/// can be seen after it: without a match nobody knows whether it was driven.
const UNSEEN_STEP_M: f64 = 30.0;
/// A trip has just begun while it has fewer keyframes, and its newest so many say how fast it is.
const KEYFRAMES_MIN: usize = 5;
const KEYFRAMES_MAX: usize = 20;

/// The scans of a step, and what is known of it.
pub(super) struct Step<'a> {
    /// The trip's last keyframe.
    pub last: &'a Keyframe,
    /// The scan as the keyframe that it would be.
    pub new: &'a Keyframe,
    /// The trip's last keyframes, in the frame of the last one's base …
    pub local_map: LocalMap<'a>,
    /// … and their points.
    pub cloud: &'a LocalCloud,
    /// `last_from_base` by the odometry.
    pub odometry: &'a OdometryMotion,
    /// `last_from_base` of the scan before the new one.
    pub before: Pose2,
    /// Whether the odometry moves as the trip never did.
    pub is_abrupt: bool,
    /// Whether it says nothing.
    pub is_silent: bool,
}

impl Step<'_> {
    /// The motion; `None` if nothing tells it.
    pub fn measure(&self) -> Option<Motion> {
        let (points, sigma_m) = (&self.new.points, self.sigma_m());
        let motion = measure_motion(&self.local_map, self.cloud, points, self.odometry, sigma_m);
        let contradicts = self.contradicts(&motion) || self.is_unseen(&motion);
        if self.is_abrupt || contradicts {
            let alone = match_alone(&self.local_map, self.cloud, points, &self.before, sigma_m);
            let alone = alone.filter(|alone| !self.contradicts(alone));
            return alone.or((!contradicts).then_some(motion));
        }
        Some(self.without_slip(&motion).unwrap_or(motion))
    }

    fn sigma_m(&self) -> f64 {
        self.new.range_sigma_m().unwrap_or(0.0)
    }

    /// The motion of a vehicle whose wheels turned while it moved otherwise. Along a corridor a
    /// match stays where the wheels have it, but what is seen through doors and at the far end is
    /// then out of place. `None` if the wheels did not slip, or did not turn.
    fn without_slip(&self, by_wheels: &Motion) -> Option<Motion> {
        let share = self.contradiction_share(&by_wheels.measurement)?;
        let way = &self.odometry.motion;
        let have_turned = !self.is_silent && way.translation().norm() >= SLIPPED_MIN_M;
        if share <= self.doubted_share() || !have_turned {
            return None;
        }
        let (points, sigma_m) = (&self.new.points, self.sigma_m());
        let others = PARTS_OF_WAY.iter().filter_map(|part| {
            let start = Pose2::new(part * way.x, part * way.y, way.theta);
            if self.contradiction_share(&start)? >= share {
                return None;
            }
            let other = match_from(self.cloud, points, &start, sigma_m)?;
            Some((self.contradiction_share(&other.measurement)?, other))
        });
        let (least, other) = others.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let apart = by_wheels.measurement.between(&other.measurement);
        let slipped = least <= DOUBTED_SHARE.min(SLIPPED_PART_MAX * share)
            && apart.translation().norm() >= SLIPPED_MIN_M;
        slipped.then_some(other)
    }

    fn doubted_share(&self) -> f64 {
        let points = self.last.points.len().min(self.new.points.len());
        DOUBTED_SHARE.max(DOUBTED_POINTS / points as f64)
    }

    fn contradiction_share(&self, last_from_base: &Pose2) -> Option<f64> {
        contradiction_share(self.last, self.new, last_from_base, &DEPTH_TOLERANCE)
    }

    fn is_unseen(&self, motion: &Motion) -> bool {
        let range_m = self.last.scan.as_ref().map(|scan| scan.lidar().range_max_m);
        let seen_m = range_m.unwrap_or(0.0).max(UNSEEN_STEP_M);
        !motion.matched && motion.measurement.translation().norm() > seen_m
    }

    fn contradicts(&self, motion: &Motion) -> bool {
        let share_max = match motion.matched {
            true => CONTRADICTION_SHARE_MAX_IF_MATCHED,
            false => CONTRADICTION_SHARE_MAX,
        };
        let share = self.contradiction_share(&motion.measurement);
        share.is_some_and(|share| share > share_max)
    }
}

/// Whether odometry moves by `motion` in a time as the trip never did. `keyframes` are the trip's,
/// in the order of the drive.
pub(super) fn is_abrupt<'a>(
    motion: &Pose2,
    elapsed_s: f64,
    keyframes: impl DoubleEndedIterator<Item = &'a Keyframe>,
) -> bool {
    let newest: Vec<&Keyframe> = keyframes.rev().take(KEYFRAMES_MAX).collect();
    let mut fastest = match newest.len() < KEYFRAMES_MIN {
        true => (UNHEARD_OF_M_PER_S, UNHEARD_OF_RAD_PER_S),
        false => (ABRUPT_M_PER_S, ABRUPT_RAD_PER_S),
    };
    for pair in newest.windows(2) {
        let (after, before) = (pair[0], pair[1]);
        let motion = before.odom_from_base.between(&after.odom_from_base);
        let elapsed_s = after.stamp.seconds() - before.stamp.seconds();
        if elapsed_s > 0.0 && after.drift_m < super::LOST_DRIFT_M {
            let (m_per_s, rad_per_s) = speed(&motion, elapsed_s);
            fastest.0 = fastest.0.max(ABRUPT_FACTOR * m_per_s);
            fastest.1 = fastest.1.max(ABRUPT_FACTOR * rad_per_s);
        }
    }
    let (m_per_s, rad_per_s) = speed(motion, elapsed_s.max(1e-3));
    m_per_s > fastest.0 || rad_per_s > fastest.1
}

fn speed(motion: &Pose2, elapsed_s: f64) -> (f64, f64) {
    let m_per_s = motion.translation().norm() / elapsed_s;
    (m_per_s, motion.theta.abs() / elapsed_s)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::Vector2;
    use crate::ids::{NodeId, StampNs, TripId};
    use crate::scan::{LaserScan, Lidar};
    use crate::sim::{Shape, World};

    const TRUTH: Pose2 = Pose2 {
        x: 0.25,
        y: 0.0,
        theta: 0.0,
    };

    fn look(world: &World, k: i64, from: &Pose2) -> Keyframe {
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
        let scan = LaserScan::new(lidar.clone(), ranges.collect::<Vec<_>>()).unwrap();
        let trip = TripId::new("t").unwrap();
        Keyframe::new(NodeId(k), trip, StampNs(k), Pose2::IDENTITY, scan)
    }

    /// The step of a vehicle that moved by [`TRUTH`], the wheels of which say `way`.
    fn measured(world: &World, way: &Pose2) -> Option<Pose2> {
        let (last, new) = (look(world, 1, &Pose2::IDENTITY), look(world, 2, &TRUTH));
        let local_map = LocalMap::new(vec![(Pose2::IDENTITY, &last.points)]);
        let mut cloud = LocalCloud::default();
        cloud.follow(last.node, &local_map);
        let step = Step {
            last: &last,
            new: &new,
            local_map,
            cloud: &cloud,
            odometry: &OdometryMotion::told(way),
            before: Pose2::IDENTITY,
            is_abrupt: false,
            is_silent: false,
        };
        step.measure().map(|motion| motion.measurement)
    }

    /// A corridor 1.6 m wide between rooms 5 m deep, a door a metre wide every 3 m on each side.
    fn with_doors() -> World {
        let wall =
            |x: f64, y: f64, length: f64| Shape::rectangle(&Pose2::new(x, y, 0.0), length, 0.1);
        let between_doors = (-8..=8).flat_map(|k| {
            let x = 3.0 * f64::from(k);
            [wall(x, 0.85, 2.0), wall(x + 1.3, -0.85, 2.0)]
        });
        World::new(between_doors.chain([wall(0.0, 6.0, 60.0), wall(0.0, -6.0, 60.0)]))
    }

    #[test]
    fn where_wheels_slip_along_a_corridor_its_doors_say_how_far() {
        for part in [1.0, 3.0, 4.0] {
            let way = Pose2::new(part * TRUTH.x, 0.0, 0.0);
            let moved = measured(&with_doors(), &way).unwrap();
            assert!((moved.x - TRUTH.x).abs() < 0.03, "{part}: {moved:?}");
        }
    }

    #[test]
    fn in_a_bare_corridor_nothing_says_that_they_slip() {
        let wall = |y: f64| Shape::rectangle(&Pose2::new(0.0, y, 0.0), 60.0, 0.1);
        let way = Pose2::new(3.0 * TRUTH.x, 0.0, 0.0);
        let moved = measured(&World::new([wall(-0.85), wall(0.85)]), &way).unwrap();
        assert!((moved.x - way.x).abs() < 0.03, "{moved:?}");
    }
}
