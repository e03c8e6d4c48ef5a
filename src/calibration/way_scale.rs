//! How much too long or too short a trip's wheels have its way, while it is being driven.
//!
//! A vehicle's earlier trips say it better ([`super::VehicleCalibration`]), but the first ones of a
//! fleet make the map and have nobody before them. Scans fix most motions by themselves; the few
//! that they do not, along bare corridors, are as long as the others show them to be.

use super::DrivenPose;
use crate::geometry::Pose2;

/// What is known of wheels without any drive, standard deviation.
const PRIOR_SIGMA: f64 = 0.02;
/// Steps as long as this are compared, metres, …
const STEP_MIN_M: f64 = 1.0;
/// … unless they go on for longer, metres: something is missing in between.
const STEP_MAX_M: f64 = 4.0;
/// In turns, a wrong mount shows as a wrong way, radians.
const TURN_MAX_RAD: f64 = 0.2;
/// Wheels that err by more than this share of the way slipped, or the scans were matched wrongly.
const SHARE_MAX: f64 = 0.25;
/// Fewest steps that say anything.
const STEPS_MIN: usize = 20;
/// Farther from the middle than so many times the usual distance, a step says nothing.
const OUTLIER_DEVIATIONS: f64 = 4.0;

/// A way by scans and by wheels, metres.
#[derive(Clone, Copy)]
struct Step {
    by_scans_m: f64,
    by_wheels_m: f64,
}

impl Step {
    fn share(&self) -> f64 {
        self.by_scans_m / self.by_wheels_m - 1.0
    }
}

/// The true way over the one by odometry, less 1, weighed against wheels being right to 2 %; 0 if
/// nothing says so. The poses are a trip's, in the order of time.
pub fn way_scale(poses: &[DrivenPose]) -> f64 {
    let mut steps = steps(poses);
    let Some((middle, usual)) = middle_and_usual_distance(&steps) else {
        return 0.0;
    };
    steps.retain(|step| (step.share() - middle).abs() <= OUTLIER_DEVIATIONS * usual);
    let (by_scans_m, by_wheels_m) = steps.iter().fold((0.0, 0.0), |(scans, wheels), step| {
        (scans + step.by_scans_m, wheels + step.by_wheels_m)
    });
    let ratio = by_scans_m / by_wheels_m;
    let left = steps
        .iter()
        .map(|step| (step.by_scans_m - ratio * step.by_wheels_m).powi(2));
    let variance = left.sum::<f64>() / by_wheels_m.powi(2);
    let weight = PRIOR_SIGMA.powi(2) / (PRIOR_SIGMA.powi(2) + variance);
    weight * (ratio - 1.0)
}

fn steps(poses: &[DrivenPose]) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut start: Option<(Pose2, Pose2)> = None;
    for pose in poses {
        let Some(map_from_base) = pose.map_from_base else {
            continue;
        };
        let here = (map_from_base, pose.odom_from_base);
        let (by_scans, by_wheels) = *start.get_or_insert(here);
        let by_scans = by_scans.between(&here.0);
        let by_wheels = by_wheels.between(&here.1);
        let step = Step {
            by_scans_m: by_scans.translation().norm(),
            by_wheels_m: by_wheels.translation().norm(),
        };
        let is_turned = by_scans.theta.abs().max(by_wheels.theta.abs()) > TURN_MAX_RAD;
        if step.by_wheels_m < STEP_MIN_M && !is_turned {
            continue;
        }
        start = Some(here);
        if !is_turned && step.by_wheels_m <= STEP_MAX_M && step.share().abs() <= SHARE_MAX {
            steps.push(step);
        }
    }
    steps
}

/// The median of the steps' shares, and the median distance from it; `None` for too few steps.
fn middle_and_usual_distance(steps: &[Step]) -> Option<(f64, f64)> {
    if steps.len() < STEPS_MIN {
        return None;
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let middle = median(steps.iter().map(Step::share).collect());
    let away = steps.iter().map(|step| (step.share() - middle).abs());
    Some((middle, median(away.collect())))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::ids::StampNs;
    use crate::sim::normal;

    /// Poses of a vehicle that moves by `steps`, the wheels of which have each so many times as long,
    /// and 5 cm off after a metre.
    fn driven(steps: impl Iterator<Item = Pose2>, wheels: f64, seed: u64) -> Vec<DrivenPose> {
        let mut noise = ChaCha8Rng::seed_from_u64(seed);
        let (mut map, mut odom) = (Pose2::IDENTITY, Pose2::new(4.0, -1.0, 2.0));
        let after = steps.enumerate().map(|(k, step)| {
            map = map.compose(&step);
            let error_m = normal(&mut noise, 0.05 * step.x.abs().sqrt());
            odom = odom.compose(&Pose2::new(wheels * step.x + error_m, step.y, step.theta));
            DrivenPose {
                stamp: StampNs(k as i64),
                map_from_base: Some(map),
                odom_from_base: odom,
            }
        });
        after.collect()
    }

    fn straight(count: usize, step_m: f64) -> impl Iterator<Item = Pose2> {
        std::iter::repeat_n(Pose2::new(step_m, 0.0, 0.002), count)
    }

    #[test]
    fn wheels_that_have_the_way_too_long_are_found_out() {
        for (wheels, step_m) in [(1.02, 1.0), (1.02, 0.3), (0.97, 0.3), (1.0, 1.0)] {
            let poses = driven(straight((400.0 / step_m) as usize, step_m), wheels, 7);
            let scale = way_scale(&poses);
            assert!(
                (scale - (1.0 / wheels - 1.0)).abs() < 0.006,
                "{wheels}: {scale}"
            );
        }
    }

    #[test]
    fn a_few_steps_say_little_and_fewer_nothing() {
        let of_steps = |count, seed| way_scale(&driven(straight(count, 1.0), 1.1, seed));
        assert_eq!(of_steps(STEPS_MIN, 3), 0.0);
        let mean = |count| (0..20).map(|seed| of_steps(count, seed)).sum::<f64>() / 20.0;
        let (few, many) = (mean(25), mean(400));
        assert!(few > 0.9 * many && few < 0.6 * many, "{few} {many}");
        assert_eq!(way_scale(&[]), 0.0);
    }

    #[test]
    fn where_wheels_slip_and_where_the_vehicle_turns_nothing_is_asked() {
        let mut poses = driven(straight(200, 1.0), 1.02, 5);
        let alone = way_scale(&poses);
        for (k, pose) in poses.iter_mut().enumerate().skip(100) {
            pose.odom_from_base.x += if k < 110 { 0.8 * (k - 99) as f64 } else { 8.0 };
        }
        assert!((way_scale(&poses) - alone).abs() < 0.004);
        let turning = std::iter::repeat_n(Pose2::new(0.5, 0.0, 0.3), 200);
        assert_eq!(way_scale(&driven(turning, 1.05, 5)), 0.0);
    }

    #[test]
    fn a_vehicle_that_stands_or_has_no_odometry_says_nothing() {
        assert_eq!(way_scale(&driven(straight(200, 0.0), 1.0, 5)), 0.0);
        let mut still = driven(straight(200, 1.0), 1.0, 5);
        for pose in &mut still {
            pose.odom_from_base = Pose2::IDENTITY;
        }
        assert_eq!(way_scale(&still), 0.0);
    }
}
