//! How far a vehicle's odometry is ahead of its scans.
//!
//! The two come from two devices, and a scan is stamped when it has been read, or when a driver
//! got round to it: on recordings a tenth of a second is nothing rare. In a turn of one radian a
//! second that is six degrees between where the wheels and where the scan say the vehicle points.
//! Headings by matched scans show it: they repeat the turns of the wheels, later or earlier.

use super::OdometryTrack;
use crate::geometry::{Pose2, wrap_angle};
use crate::ids::StampNs;

/// A scan of a trip: where the map has it and where its odometry had it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrivenPose {
    /// When it was taken.
    pub stamp: StampNs,
    /// Where the map has its base; `None` where nothing but the odometry says so.
    pub map_from_base: Option<Pose2>,
    /// In the odometry frame, as it was sent.
    pub odom_from_base: Pose2,
}

/// Offsets up to this are searched for, steps of [`STEP_S`]: 0.3 s.
const STEPS: i64 = 30;
const STEP_S: f64 = 0.01;
/// Scans farther apart than this say nothing of such offsets, seconds.
const APART_MAX_S: f64 = 0.25;
/// Fewest turns from scan to scan.
const TURNS_MIN: usize = 60;
/// So many of the newest are asked.
const TURNS_MAX: usize = 600;
/// What a turn by the map and one by odometry differ by counts no more than this, radians: scans
/// are matched wrongly now and then.
const DIFFERENCE_MAX_RAD: f64 = 0.1;
/// The differences with the offset, as a share of those without.
const LEFT_MAX: f64 = 0.85;
/// Less is none, seconds.
const OFFSET_MIN_S: f64 = 0.02;

/// How long after the odometry of the same stamp scans show a motion, seconds; 0 if it cannot be
/// distinguished from none. The poses are a trip's, in the order of time.
pub fn clock_offset_s(poses: &[DrivenPose]) -> f64 {
    let track = OdometryTrack::through(poses.iter().map(|p| (p.stamp, p.odom_from_base)));
    let matched: Vec<(i64, Pose2)> = poses
        .iter()
        .filter_map(|pose| Some((pose.stamp.0, pose.map_from_base?)))
        .collect();
    let is_near = |pair: &&[(i64, Pose2)]| (pair[1].0 - pair[0].0) as f64 <= 1e9 * APART_MAX_S;
    let turns: Vec<&[(i64, Pose2)]> = matched.windows(2).filter(is_near).collect();
    if turns.len() < TURNS_MIN {
        return 0.0;
    }
    let turns = &turns[turns.len().saturating_sub(TURNS_MAX)..];
    let difference_with = |steps: i64| -> f64 {
        let offset_ns = steps * (STEP_S * 1e9) as i64;
        let of_turn = turns.iter().filter_map(|pair| {
            let from = track.at(pair[0].0 - offset_ns)?;
            let to = track.at(pair[1].0 - offset_ns)?;
            let by_map_rad = wrap_angle(pair[1].1.theta - pair[0].1.theta);
            let difference_rad = wrap_angle(by_map_rad - wrap_angle(to.theta - from.theta));
            Some(difference_rad.abs().min(DIFFERENCE_MAX_RAD))
        });
        of_turn.sum()
    };
    let differences: Vec<f64> = (-STEPS..=STEPS).map(difference_with).collect();
    let none = differences[STEPS as usize];
    let best = (0..differences.len()).min_by(|&a, &b| differences[a].total_cmp(&differences[b]));
    let Some(best) = best else {
        return 0.0;
    };
    let at_an_end = best == 0 || best + 1 == differences.len();
    let offset_s = STEP_S * (best as i64 - STEPS) as f64;
    match at_an_end || differences[best] > LEFT_MAX * none || offset_s.abs() < OFFSET_MIN_S {
        true => 0.0,
        false => offset_s,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// A vehicle that weaves: where it is after so many seconds.
    fn truth(seconds: f64) -> Pose2 {
        let heading_rad = 0.8 * (1.1 * seconds).sin() + 0.4 * (0.37 * seconds).sin();
        Pose2::new(0.5 * seconds, 0.2 * seconds.sin(), heading_rad)
    }

    /// Scans that show it `late_s` later than its odometry, with errors of the matches.
    fn driven(count: usize, every_s: f64, late_s: f64, error_rad: f64) -> Vec<DrivenPose> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut pose = |k: usize| {
            let seconds = every_s * k as f64;
            let seen = truth(seconds - late_s);
            let error_rad = error_rad * (2.0 * rng.random::<f64>() - 1.0);
            DrivenPose {
                stamp: StampNs((1e9 * seconds) as i64),
                map_from_base: Some(Pose2::new(seen.x, seen.y, seen.theta + error_rad)),
                odom_from_base: truth(seconds),
            }
        };
        (0..count).map(&mut pose).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn an_offset_is_measured(late_s in -0.25..0.25_f64) {
            let found_s = clock_offset_s(&driven(300, 0.1, late_s, 0.003));
            // Less than two hundredths is none, and a little more may be hidden by the errors.
            let may_be_none = late_s.abs() < 0.08 && found_s == 0.0;
            prop_assert!((found_s - late_s).abs() < 0.02 || may_be_none, "{} {}", found_s, late_s);
        }
    }

    #[test]
    fn what_does_not_show_is_none() {
        // In step; too few turns; scans too far apart; errors larger than the turns.
        assert_eq!(clock_offset_s(&driven(300, 0.1, 0.0, 0.01)), 0.0);
        assert_eq!(clock_offset_s(&driven(50, 0.1, 0.15, 0.0)), 0.0);
        assert_eq!(clock_offset_s(&driven(300, 0.5, 0.15, 0.0)), 0.0);
        assert_eq!(clock_offset_s(&driven(300, 0.1, 0.15, 0.4)), 0.0);
        assert_eq!(clock_offset_s(&[]), 0.0);
        let straight = driven(300, 0.1, 0.15, 0.01)
            .into_iter()
            .map(|pose| DrivenPose {
                map_from_base: pose
                    .map_from_base
                    .map(|p| Pose2::new(p.x, p.y, 0.001 * p.theta)),
                odom_from_base: Pose2::new(pose.odom_from_base.x, 0.0, 0.0),
                ..pose
            });
        assert_eq!(clock_offset_s(&straight.collect::<Vec<_>>()), 0.0);
    }
}
