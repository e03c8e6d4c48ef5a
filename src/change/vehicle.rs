//! Whether a vehicle's lidar sits as the vehicle says.

use super::median::median;
use super::region::region_round;
use super::{ChangeKind, Finding, Tier};
use crate::geometry::{Pose2, Vector2, angle_difference_rad, wrap_angle};
use crate::ids::{NodeId, StampNs, TripId};

/// Motions from keyframe to keyframe that say where the vehicle points: at least so long, metres,
const WAY_MIN_M: f64 = 0.15;
/// and turned by no more than this, radians.
const TURN_MAX_RAD: f64 = 0.1;
/// So many of them are asked.
const MOTIONS_MIN: usize = 40;
/// A lidar turned by less is not worth a word, radians.
const TURNED_MIN_RAD: f64 = 0.0175;
/// How many standard errors the turn must be away from none.
const STANDARD_ERRORS: f64 = 10.0;
/// Standard deviation of a normal distribution over its median absolute deviation.
const SIGMA_OVER_MAD: f64 = 1.4826;
/// Standard error of a median over that of a mean.
const MEDIAN_OVER_MEAN: f64 = 1.2533;
/// Radius of the region that stands for where the vehicle was seen first, metres.
const REGION_RADIUS_M: f64 = 0.3;

/// A keyframe of a trip: where the map has it and where its odometry had it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TripPose {
    /// The node.
    pub node: NodeId,
    /// When.
    pub stamp: StampNs,
    /// In the map, as its scans say.
    pub map_from_base: Pose2,
    /// In the odometry frame, as its wheels say.
    pub odom_from_base: Pose2,
}

/// How a lidar sits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MountTurn {
    /// Median turn from the way that the wheels drove to the way that the scans moved, radians.
    pub turn_rad: f64,
    /// Its standard error, radians.
    pub sigma_rad: f64,
}

/// The turn of a vehicle's lidar on its mount beyond what it states, from the straight motions of
/// its trips: wheels know where ahead is. `None` if there are too few of them.
pub fn mount_turn<'a>(trips: impl IntoIterator<Item = &'a [TripPose]>) -> Option<MountTurn> {
    let pairs = trips.into_iter().flat_map(|poses| poses.windows(2));
    let mut turns: Vec<f64> = pairs.filter_map(turn_of).collect();
    if turns.len() < MOTIONS_MIN {
        return None;
    }
    let turn_rad = median(&mut turns);
    let mut deviations: Vec<f64> = turns.iter().map(|turn| (turn - turn_rad).abs()).collect();
    let sigma_rad = SIGMA_OVER_MAD * median(&mut deviations);
    Some(MountTurn {
        turn_rad,
        sigma_rad: MEDIAN_OVER_MEAN * sigma_rad / (turns.len() as f64).sqrt(),
    })
}

/// From the course that the scans moved to the one that the wheels drove, if both are straight.
fn turn_of(pair: &[TripPose]) -> Option<f64> {
    let by_wheels = pair[0].odom_from_base.between(&pair[1].odom_from_base);
    let by_scans = pair[0].map_from_base.between(&pair[1].map_from_base);
    let is_straight = |motion: &Pose2| {
        motion.translation().norm() >= WAY_MIN_M
            && angle_difference_rad(motion.theta, 0.0) <= TURN_MAX_RAD
    };
    let course = |motion: &Pose2| motion.y.atan2(motion.x) - 0.5 * motion.theta;
    (is_straight(&by_wheels) && is_straight(&by_scans))
        .then(|| wrap_angle(course(&by_wheels) - course(&by_scans)))
}

/// A finding against the vehicle of these trips if its lidar is turned on its mount.
pub fn suspect_vehicle(trips: &[(&TripId, Vec<TripPose>)]) -> Option<Finding> {
    let mount = mount_turn(trips.iter().map(|(_, poses)| poses.as_slice()))?;
    let turned_rad = mount.turn_rad.abs();
    if turned_rad < TURNED_MIN_RAD || turned_rad < STANDARD_ERRORS * mount.sigma_rad {
        return None;
    }
    let poses = || trips.iter().flat_map(|(_, poses)| poses);
    let first = poses().min_by_key(|pose| pose.stamp)?;
    let location: Vector2<f64> = first.map_from_base.translation();
    Some(Finding {
        tier: Tier::Confirmed,
        counterpart: None,
        shift: None,
        bands: Vec::new(),
        kind: ChangeKind::VehicleSuspect,
        location,
        sigma_m: REGION_RADIUS_M,
        region: region_round(&[location], REGION_RADIUS_M),
        edges: Vec::new(),
        nodes: vec![first.node],
        trips: trips.iter().map(|(trip, _)| (*trip).clone()).collect(),
        views: poses().count(),
        laps: trips.len(),
        confidence: 1.0 - (-turned_rad / mount.sigma_rad).exp(),
        since: first.stamp,
        last_seen: poses().map(|pose| pose.stamp).max().unwrap_or(first.stamp),
        until: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A drive of straight sides and corners whose scans see the vehicle turned by `turn_rad`.
    fn drive(count: usize, turn_rad: f64, wobble_rad: f64) -> Vec<TripPose> {
        let mut odom_from_base = Pose2::new(3.0, -1.0, 0.7);
        let map_from_odom = Pose2::new(-4.0, 2.0, 2.5);
        let turned = Pose2::new(0.0, 0.0, turn_rad);
        let pose = |k: usize| {
            let wobble = if k.is_multiple_of(2) {
                wobble_rad
            } else {
                -wobble_rad
            };
            let corner = if k % 20 == 19 { 1.5 } else { 0.0 };
            odom_from_base = odom_from_base.compose(&Pose2::new(0.5, 0.0, corner + wobble));
            TripPose {
                node: NodeId(k as i64),
                stamp: StampNs(k as i64),
                map_from_base: map_from_odom.compose(&odom_from_base).compose(&turned),
                odom_from_base,
            }
        };
        (0..count).map(pose).collect()
    }

    proptest! {
        #[test]
        fn a_turned_lidar_is_measured(turn_rad in -0.1..0.1_f64, wobble_rad in 0.0..0.02_f64) {
            let poses = drive(120, turn_rad, wobble_rad);
            let mount = mount_turn([poses.as_slice()]).unwrap();
            prop_assert!((mount.turn_rad.abs() - turn_rad.abs()).abs() < 1e-3 + wobble_rad);
        }
    }

    #[test]
    fn only_a_lidar_that_is_clearly_turned_is_told() {
        let trip = TripId::new("monday").unwrap();
        let told = |poses: Vec<TripPose>| suspect_vehicle(&[(&trip, poses)]);
        assert!(told(drive(120, 0.0, 0.01)).is_none());
        assert!(told(drive(120, 0.012, 0.001)).is_none());
        assert!(told(drive(20, 0.035, 0.001)).is_none());
        let finding = told(drive(120, 0.035, 0.001)).unwrap();
        assert_eq!(finding.kind, ChangeKind::VehicleSuspect);
        assert_eq!(finding.trips, std::slice::from_ref(&trip));
        assert!(finding.confidence > 0.99);
    }

    #[test]
    fn motions_across_two_trips_are_none() {
        let (a, b) = (drive(30, 0.035, 0.001), drive(12, 0.035, 0.001));
        assert!(mount_turn([a.as_slice(), b.as_slice()]).is_none());
        let both: Vec<TripPose> = a.into_iter().chain(b).collect();
        assert!(
            mount_turn([both.as_slice()]).is_none(),
            "corners count as none"
        );
    }
}
