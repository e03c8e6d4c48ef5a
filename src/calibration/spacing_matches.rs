//! Beam spacing as a fourth unknown of the match of two scans.
//!
//! A pure turn says nothing of it: with beams stated too far apart the whole turn seems too large,
//! and so does every bearing. What shows it is the way between two scans: things come to lie at
//! other bearings than that way allows. Pairs without a turn are left out all the same: on
//! recordings of corridors they are wrong by two per cent, always to the same side.
//!
//! A lidar that sweeps while its vehicle turns has its beams farther apart or closer together, by
//! turns to the left and to the right in opposite ways; a drive should have both.
//!
//! The beams of an all-round lidar fill a turn, and there is nothing to find.

use std::sync::Arc;

use super::corrections::with_spacing;
use super::joint_match::{Moving, PoseSigmas, step_of_unknown};
use super::shared_value::{Measured, shared_value};
use super::{Estimate, Quantity};
use crate::geometry::{Pose2, Vector2, wrap_angle};
use crate::matching::{IcpParams, ReferenceCloud, Termination, align};
use crate::scan::{LaserScan, Lidar, SurfacePoint, surface_points};

/// Two scans of one lidar and what its wheels say of the way between them.
#[derive(Debug, Clone, Copy)]
pub struct ScanPair<'a> {
    /// The first.
    pub from: &'a LaserScan,
    /// The second.
    pub to: &'a LaserScan,
    /// `from_from_to`, base frames.
    pub motion: Pose2,
}

/// Pairs that have turned less are left out, radians.
const TURN_MIN_RAD: f64 = 0.1;
const STEPS_MAX: usize = 10;
const STEP_MAX: f64 = 0.04;
const STEP_TOLERANCE: f64 = 2e-4;
/// Factors beyond this are none.
const SPACING_MAX: f64 = 0.25;
/// A match with fewer inliers is none.
const INLIER_SHARE_MIN: f64 = 0.6;
/// Fewest pairs that move the factor.
const PAIRS_MIN: usize = 8;

/// What pairs of a trip's scans, in the order of time, say of [`Quantity::BeamSpacing`]. Pairs that
/// are 0.3 to 1.5 m apart and turned say most. `None` without enough of them that match.
pub fn spacing_by_matches(pairs: &[ScanPair<'_>]) -> Option<Estimate> {
    let is_turned = |pair: &&ScanPair<'_>| pair.motion.theta.abs() >= TURN_MIN_RAD;
    let pairs: Vec<ScanPair<'_>> = pairs.iter().filter(is_turned).copied().collect();
    let mut spacing = 0.0;
    let mut matched: Vec<Pose2> = pairs.iter().map(|pair| pair.motion).collect();
    let mut asked: Vec<Measured> = Vec::new();
    for _ in 0..STEPS_MAX {
        asked = asked_by(&pairs, &mut matched, spacing);
        if asked.len() < PAIRS_MIN {
            return None;
        }
        let step = mean(&asked).clamp(-STEP_MAX, STEP_MAX);
        spacing += step;
        if spacing.abs() > SPACING_MAX {
            return None;
        }
        if step.abs() < STEP_TOLERANCE {
            break;
        }
    }
    for measured in &mut asked {
        measured.value += spacing;
    }
    shared_value(Quantity::BeamSpacing, &asked)
}

/// Weighted mean of what lies within reach of the median.
fn mean(asked: &[Measured]) -> f64 {
    let mut values: Vec<f64> = asked.iter().map(|measured| measured.value).collect();
    values.sort_unstable_by(f64::total_cmp);
    let (low, high) = (
        values[values.len() / 8],
        values[values.len() - 1 - values.len() / 8],
    );
    let near = asked
        .iter()
        .filter(|measured| (low..=high).contains(&measured.value));
    let (sum, weights) = near.fold((0.0, 0.0), |(sum, weights), measured| {
        (
            sum + measured.information * measured.value,
            weights + measured.information,
        )
    });
    sum / weights
}

/// The step that each pair asks for; `matched` is where the pairs were matched last.
fn asked_by(pairs: &[ScanPair<'_>], matched: &mut [Pose2], spacing: f64) -> Vec<Measured> {
    let pairs = pairs.iter().zip(matched);
    pairs
        .filter_map(|(pair, matched)| asked_by_pair(pair, matched, spacing))
        .collect()
}

fn asked_by_pair(pair: &ScanPair<'_>, matched: &mut Pose2, spacing: f64) -> Option<Measured> {
    let stated = pair.from.lidar();
    let beams = pair.from.beam_count();
    let lidar = Arc::new(with_spacing(stated, beams, 1.0 + spacing));
    let points = |scan: &LaserScan| {
        let scan = LaserScan::from_ticks(lidar.clone(), scan.ticks()).ok()?;
        Some(surface_points(&scan))
    };
    let (from, to) = (points(pair.from)?, points(pair.to)?);
    let reference = ReferenceCloud::new([(Pose2::IDENTITY, from.as_slice())])?;
    let sigma_m = lidar.range_sigma_m;
    let estimate = align(&reference, &to, matched, sigma_m, None, &IcpParams::ROBUST);
    let way_m = pair.motion.translation().norm();
    let sigmas = PoseSigmas {
        xy_m: 0.02 + 0.05 * way_m,
        theta_rad: 0.05 + 0.2 * pair.motion.theta.abs(),
    };
    let off = pair.motion.between(&estimate.pose);
    let is_near = off.translation().norm() < 0.15 + 5.0 * sigmas.xy_m
        && off.theta.abs() < 5.0 * sigmas.theta_rad;
    let is_matched = estimate.termination != Termination::TooFewPoints;
    if !is_matched || !is_near || estimate.inlier_share < INLIER_SHARE_MIN {
        return None;
    }
    *matched = estimate.pose;
    let fan = Fan::of(stated, beams, spacing);
    let moving = Moving {
        point: |point: &SurfacePoint| fan.swung(&point.position, fan.stated_rad(point.beam)),
        place: |place: &Vector2<f64>| fan.swung(place, fan.stated_rad_of(place)),
    };
    step_of_unknown(
        &reference,
        &to,
        &estimate.pose,
        &pair.motion,
        &sigmas,
        sigma_m,
        &moving,
    )
}

/// Where the beams of a lidar with another spacing lie.
struct Fan {
    eye: Vector2<f64>,
    /// Of the middle beam, base frame, radians.
    middle_rad: f64,
    middle_beam: f64,
    stated_spacing_rad: f64,
    factor: f64,
}

impl Fan {
    fn of(stated: &Lidar, beams: usize, spacing: f64) -> Self {
        let middle_beam = 0.5 * (beams as f64 - 1.0);
        let stated_spacing_rad = stated.angle_increment_rad;
        Self {
            eye: stated.mount.translation(),
            middle_rad: stated.mount.theta
                + stated.angle_min_rad
                + middle_beam * stated_spacing_rad,
            middle_beam,
            stated_spacing_rad,
            factor: 1.0 + spacing,
        }
    }

    /// The stated angle of a beam from the middle.
    fn stated_rad(&self, beam: usize) -> f64 {
        (beam as f64 - self.middle_beam) * self.stated_spacing_rad
    }

    /// The same for what lies at a place, base frame.
    fn stated_rad_of(&self, place: &Vector2<f64>) -> f64 {
        let ray = place - self.eye;
        wrap_angle(ray.y.atan2(ray.x) - self.middle_rad) / self.factor
    }

    /// How a point moves with the factor, metres.
    fn swung(&self, point: &Vector2<f64>, stated_rad: f64) -> Vector2<f64> {
        let ray = point - self.eye;
        stated_rad * Vector2::new(-ray.y, ray.x)
    }
}

#[cfg(test)]
mod tests;
