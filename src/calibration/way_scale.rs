//! How much too long or too short a trip's wheels have its way, while it is being driven.
//!
//! A vehicle's earlier trips say it better ([`super::VehicleCalibration`]), but the first ones of a
//! fleet make the map and have nobody before them. Scans fix most motions by themselves; the few
//! that they do not, along bare corridors, are as long as the others show them to be.

use super::Quantity;
use crate::geometry::Pose2;

/// A motion from one of a trip's keyframes to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrivenStep {
    /// `last_from_base`, as the scans were matched; `None` where they were not.
    pub by_scans: Option<Pose2>,
    /// `last_from_base`, as it was sent.
    pub by_wheels: Pose2,
}

/// What is known of wheels without any drive, standard deviation.
const PRIOR_SIGMA: f64 = 0.02;
/// Matches of the scans may be off by so much themselves, and differ by it from run to run.
const SCALE_NONE: f64 = 0.004;
/// Ways as long as this are compared, metres, …
const WAY_MIN_M: f64 = 1.0;
/// … unless they are longer, metres: something is missing in between.
const WAY_MAX_M: f64 = 4.0;
/// In turns, a wrong mount shows as a wrong way, radians.
const TURN_MAX_RAD: f64 = 0.2;
/// Wheels that err by more than this share of the way slipped, or the scans were matched wrongly.
const SHARE_MAX: f64 = 0.25;
/// Fewest ways that say anything.
const WAYS_MIN: usize = 20;
/// Farther from the middle than so many times the usual distance, a way says nothing.
const OUTLIER_DEVIATIONS: f64 = 4.0;

/// A way by scans and by wheels, metres.
#[derive(Clone, Copy)]
struct Way {
    by_scans_m: f64,
    by_wheels_m: f64,
}

impl Way {
    fn share(&self) -> f64 {
        self.by_scans_m / self.by_wheels_m - 1.0
    }
}

/// The true way over the one by odometry, less 1, weighed against wheels being right to 2 %; less,
/// down to 0, where it is not worth a correction, and 0 if nothing says so. The steps are a trip's, in
/// the order of the drive.
pub fn way_scale(steps: &[DrivenStep]) -> f64 {
    let mut ways = ways(steps);
    let Some((middle, usual)) = middle_and_usual_distance(&ways) else {
        return 0.0;
    };
    ways.retain(|way| (way.share() - middle).abs() <= OUTLIER_DEVIATIONS * usual);
    let (by_scans_m, by_wheels_m) = ways.iter().fold((0.0, 0.0), |(scans, wheels), way| {
        (scans + way.by_scans_m, wheels + way.by_wheels_m)
    });
    let ratio = by_scans_m / by_wheels_m;
    let left_m2 = ways
        .iter()
        .map(|way| (way.by_scans_m - ratio * way.by_wheels_m).powi(2));
    let variance = left_m2.sum::<f64>() / by_wheels_m.powi(2);
    let weight = PRIOR_SIGMA.powi(2) / (PRIOR_SIGMA.powi(2) + variance);
    let scale = weight * (ratio - 1.0);
    let worth = Quantity::WayScale.applied_min();
    scale * ((scale.abs() - SCALE_NONE) / (worth - SCALE_NONE)).clamp(0.0, 1.0)
}

fn ways(steps: &[DrivenStep]) -> Vec<Way> {
    let start = (Pose2::IDENTITY, Pose2::IDENTITY);
    let mut ways = Vec::new();
    let mut driven = start;
    for step in steps {
        let Some(by_scans) = step.by_scans else {
            driven = start;
            continue;
        };
        driven = (
            driven.0.compose(&by_scans),
            driven.1.compose(&step.by_wheels),
        );
        let way = Way {
            by_scans_m: driven.0.translation().norm(),
            by_wheels_m: driven.1.translation().norm(),
        };
        let is_turned = driven.0.theta.abs().max(driven.1.theta.abs()) > TURN_MAX_RAD;
        if is_turned || way.by_wheels_m >= WAY_MIN_M {
            driven = start;
            if !is_turned && way.by_wheels_m <= WAY_MAX_M && way.share().abs() <= SHARE_MAX {
                ways.push(way);
            }
        }
    }
    ways
}

/// The median of the ways' shares, and the median distance from it; `None` for too few ways.
fn middle_and_usual_distance(ways: &[Way]) -> Option<(f64, f64)> {
    if ways.len() < WAYS_MIN {
        return None;
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let middle = median(ways.iter().map(Way::share).collect());
    let away = ways.iter().map(|way| (way.share() - middle).abs());
    Some((middle, median(away.collect())))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::sim::normal;

    /// The steps of a vehicle, the wheels of which have each so many times as long, and 5 cm off after
    /// a metre.
    fn driven(steps: impl Iterator<Item = Pose2>, wheels: f64, seed: u64) -> Vec<DrivenStep> {
        let mut noise = ChaCha8Rng::seed_from_u64(seed);
        let driven = steps.map(|step| {
            let error_m = normal(&mut noise, 0.05 * step.x.abs().sqrt());
            DrivenStep {
                by_scans: Some(step),
                by_wheels: Pose2::new(wheels * step.x + error_m, step.y, step.theta),
            }
        });
        driven.collect()
    }

    fn straight(count: usize, step_m: f64) -> impl Iterator<Item = Pose2> {
        std::iter::repeat_n(Pose2::new(step_m, 0.0, 0.002), count)
    }

    #[test]
    fn wheels_that_have_the_way_too_long_are_found_out() {
        for (wheels, step_m) in [(1.02, 1.0), (1.02, 0.3), (0.97, 0.3), (1.0, 1.0)] {
            let steps = driven(straight((400.0 / step_m) as usize, step_m), wheels, 7);
            let scale = way_scale(&steps);
            assert!(
                (scale - (1.0 / wheels - 1.0)).abs() < 0.006,
                "{wheels}: {scale}"
            );
        }
    }

    #[test]
    fn a_few_steps_say_little_and_fewer_nothing() {
        let of_steps = |count, seed| way_scale(&driven(straight(count, 1.0), 1.1, seed));
        assert_eq!(of_steps(WAYS_MIN - 1, 3), 0.0);
        let mean = |count| (0..20).map(|seed| of_steps(count, seed)).sum::<f64>() / 20.0;
        let (few, many) = (mean(25), mean(400));
        assert!(few > 0.9 * many && few < 0.6 * many, "{few} {many}");
        assert_eq!(way_scale(&[]), 0.0);
    }

    #[test]
    fn where_wheels_slip_and_where_the_vehicle_turns_nothing_is_asked() {
        let mut steps = driven(straight(200, 1.0), 1.02, 5);
        let alone = way_scale(&steps);
        for step in &mut steps[100..110] {
            step.by_wheels.x += 0.8;
        }
        assert!((way_scale(&steps) - alone).abs() < 0.004);
        let right = way_scale(&driven(straight(400, 1.0), 1.001, 5));
        assert_eq!(right, 0.0, "not worth a correction");
        let turning = std::iter::repeat_n(Pose2::new(0.5, 0.0, 0.3), 200);
        assert_eq!(way_scale(&driven(turning, 1.05, 5)), 0.0);
    }

    #[test]
    fn a_vehicle_that_stands_or_is_not_matched_says_nothing() {
        assert_eq!(way_scale(&driven(straight(200, 0.0), 1.0, 5)), 0.0);
        let mut still = driven(straight(200, 1.0), 1.0, 5);
        for step in &mut still {
            step.by_wheels = Pose2::IDENTITY;
        }
        assert_eq!(way_scale(&still), 0.0);
        let mut unmatched = driven(straight(200, 1.0), 1.05, 5);
        for step in &mut unmatched {
            step.by_scans = None;
        }
        assert_eq!(way_scale(&unmatched), 0.0);
    }
}
