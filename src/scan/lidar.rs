//! The geometry of a lidar and where it is mounted.

use super::limits::RANGE_MAX_M;
use super::{BandError, BandView, HeightBand};
use crate::geometry::{Pose2, Vector2};

/// Range noise assumed where the sender states none, metres.
pub const RANGE_SIGMA_DEFAULT_M: f64 = 0.01;

/// Beams whose directions are derived from one computed direction.
const BEAMS_TOGETHER: usize = 32;
const MOUNT_OFFSET_MAX_M: f64 = 50.0;
/// Least angle between beams; with it, the most beams cover 47°.
const ANGLE_INCREMENT_MIN_RAD: f64 = 1e-4;

/// The geometry of a lidar: beam k points along `angle_min_rad + k · angle_increment_rad` in the
/// lidar frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Lidar {
    /// Direction of the first beam, radians, lidar frame.
    pub angle_min_rad: f64,
    /// Angle between two beams, radians, positive.
    pub angle_increment_rad: f64,
    /// Shorter ranges are invalid, metres.
    pub range_min_m: f64,
    /// Ranges of this length or longer are no returns, metres.
    pub range_max_m: f64,
    /// `base_from_lidar`.
    pub mount: Pose2,
    /// Standard deviation of one range, metres.
    pub range_sigma_m: f64,
    /// The heights that its scans are made of, if they are virtual ones of a 3D lidar.
    pub band: Option<BandView>,
}

/// Why a lidar's geometry is refused; the text explains it to the sender.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LidarError {
    /// `angle_min` is not an angle.
    #[error("angle_min {0} is not within ±2π: did you send degrees?")]
    AngleMin(f64),
    /// `angle_increment` is not a small angle.
    #[error(
        "angle_increment {0} is not within [{ANGLE_INCREMENT_MIN_RAD}, π/4], nor the same below 0 for a lidar that scans clockwise: did you send degrees?"
    )]
    AngleIncrement(f64),
    /// `range_min` is negative or not below `range_max`.
    #[error("range_min {range_min_m} must be at least 0 and below range_max {range_max_m}")]
    RangeMin {
        /// As sent.
        range_min_m: f64,
        /// As sent.
        range_max_m: f64,
    },
    /// `range_max` is not usable.
    #[error("range_max {0} is not within (0, {RANGE_MAX_M}] m: did you send millimetres?")]
    RangeMax(f64),
    /// The mount is not finite or metres away from the vehicle.
    #[error("the mount is not finite or more than {MOUNT_OFFSET_MAX_M} m from the base")]
    Mount,
    /// The noise is not usable.
    #[error("range_sigma {0} is not within (0, 1] m")]
    RangeSigma(f64),
    /// The height band is not usable.
    #[error(transparent)]
    Band(#[from] BandError),
}

impl Lidar {
    /// Checks the geometry.
    ///
    /// # Errors
    /// The first [`LidarError`] that applies.
    pub fn validated(self) -> Result<Self, LidarError> {
        use std::f64::consts::{FRAC_PI_4, TAU};
        if !(-TAU..=TAU).contains(&self.angle_min_rad) {
            return Err(LidarError::AngleMin(self.angle_min_rad));
        }
        if !(ANGLE_INCREMENT_MIN_RAD..=FRAC_PI_4).contains(&self.angle_increment_rad) {
            return Err(LidarError::AngleIncrement(self.angle_increment_rad));
        }
        if !(self.range_max_m > 0.0 && self.range_max_m <= RANGE_MAX_M) {
            return Err(LidarError::RangeMax(self.range_max_m));
        }
        if !(self.range_min_m >= 0.0 && self.range_min_m < self.range_max_m) {
            return Err(LidarError::RangeMin {
                range_min_m: self.range_min_m,
                range_max_m: self.range_max_m,
            });
        }
        if !self.mount.is_finite() || self.mount.translation().norm() > MOUNT_OFFSET_MAX_M {
            return Err(LidarError::Mount);
        }
        if !(self.range_sigma_m > 0.0 && self.range_sigma_m <= 1.0) {
            return Err(LidarError::RangeSigma(self.range_sigma_m));
        }
        self.band.map(BandView::validated).transpose()?;
        Ok(self)
    }

    /// The counter-clockwise lidar with the same beams as this one, whose `beams` go clockwise from
    /// `angle_min_rad`.
    #[must_use]
    pub fn counter_clockwise(self, beams: usize) -> Self {
        use std::f64::consts::{PI, TAU};
        let covered_rad = beams.saturating_sub(1) as f64 * self.angle_increment_rad;
        let last_rad = self.angle_min_rad - covered_rad;
        let turn_rad = if last_rad < -PI { TAU } else { 0.0 };
        Self {
            angle_min_rad: last_rad + turn_rad,
            ..self
        }
    }

    /// Direction of a beam, radians, lidar frame.
    pub fn beam_angle_rad(&self, beam: usize) -> f64 {
        self.angle_min_rad + beam as f64 * self.angle_increment_rad
    }

    /// Unit vectors along the first beams, lidar frame: cosine and sine of
    /// [`Lidar::beam_angle_rad`], to a few units in the last place.
    pub fn beam_directions(&self, count: usize) -> impl Iterator<Item = Vector2<f64>> + '_ {
        // Angle sums from two short lists: most sines and cosines need not be computed.
        let direction = |angle_rad: f64| Vector2::new(angle_rad.cos(), angle_rad.sin());
        let within = std::array::from_fn::<_, BEAMS_TOGETHER, _>(|k| {
            direction(k as f64 * self.angle_increment_rad)
        });
        (0..count).step_by(BEAMS_TOGETHER).flat_map(move |first| {
            let of_first = direction(self.beam_angle_rad(first));
            let turned = move |by: Vector2<f64>| {
                Vector2::new(
                    of_first.x * by.x - of_first.y * by.y,
                    of_first.y * by.x + of_first.x * by.y,
                )
            };
            within.into_iter().take(count - first).map(turned)
        })
    }

    /// The height band of its scans; `None` for a planar lidar.
    pub fn height_band(&self) -> Option<HeightBand> {
        self.band.map(|view| view.band)
    }

    /// Whether its scans can show free space at this distance, metres.
    pub fn is_clear_at(&self, range_m: f64) -> bool {
        self.band.is_none_or(|view| view.is_clear_at(range_m))
    }

    /// Length of one tick of a stored range: 1 mm, or coarser for lidars beyond 65 m.
    pub fn tick_m(&self) -> f64 {
        (self.range_max_m / f64::from(u16::MAX - 1)).max(1e-3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> Lidar {
        Lidar {
            angle_min_rad: -1.5,
            angle_increment_rad: 0.01,
            range_min_m: 0.05,
            range_max_m: 20.0,
            mount: Pose2::IDENTITY,
            range_sigma_m: 0.01,
            band: None,
        }
    }

    #[test]
    fn directions_are_those_of_the_angles() {
        let lidar = Lidar {
            angle_min_rad: -2.1,
            angle_increment_rad: 0.005,
            ..good()
        };
        for count in [0, 1, BEAMS_TOGETHER, 2 * BEAMS_TOGETHER + 1, 841] {
            let directions: Vec<_> = lidar.beam_directions(count).collect();
            assert_eq!(directions.len(), count);
            for (beam, direction) in directions.iter().enumerate() {
                let (sin, cos) = lidar.beam_angle_rad(beam).sin_cos();
                assert!(
                    (direction - Vector2::new(cos, sin)).norm() < 1e-15,
                    "{beam}"
                );
            }
        }
    }

    #[test]
    fn clockwise_beams_are_the_same_from_the_other_end() {
        for (first_rad, beams) in [(1.5, 301), (-3.1, 628), (-0.2, 2), (0.0, 1)] {
            let clockwise = Lidar {
                angle_min_rad: first_rad,
                ..good()
            };
            let flipped = clockwise
                .clone()
                .counter_clockwise(beams)
                .validated()
                .unwrap();
            for beam in 0..beams {
                let sent_rad = first_rad - beam as f64 * clockwise.angle_increment_rad;
                let apart_rad = flipped.beam_angle_rad(beams - 1 - beam) - sent_rad;
                assert!(
                    crate::geometry::wrap_angle(apart_rad).abs() < 1e-12,
                    "{beam}"
                );
            }
        }
    }

    #[test]
    fn absurd_geometry_is_refused() {
        assert!(good().validated().is_ok());
        let spoilers: [fn(&mut Lidar); 11] = [
            |l| l.angle_min_rad = f64::NAN,
            |l| l.angle_min_rad = -180.0,
            |l| l.angle_increment_rad = 0.0,
            |l| l.angle_increment_rad = 1e-12,
            |l| l.angle_increment_rad = 1.0,
            |l| l.range_max_m = 20_000.0,
            |l| l.range_min_m = 20.0,
            |l| l.range_min_m = -0.1,
            |l| l.mount.x = f64::INFINITY,
            |l| l.range_sigma_m = 0.0,
            |l| {
                let band = HeightBand {
                    from_m: 0.4,
                    to_m: 0.1,
                };
                l.band = Some(BandView::all_the_way(band, 20.0));
            },
        ];
        for (k, spoil) in spoilers.iter().enumerate() {
            let mut lidar = good();
            spoil(&mut lidar);
            assert!(lidar.validated().is_err(), "spoiler {k}");
        }
    }
}
