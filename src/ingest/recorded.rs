//! What recordings hold, whatever their format: lidars, and scans with the odometry of their time.

use crate::geometry::Pose2;
use crate::ids::{LidarId, StampNs};
use crate::scan::Lidar;

/// What is said of a recording whose times are seconds since its beginning, or of a simulation.
pub(super) const RELATIVE_TIMES_NOTE: &str =
    "its times count from an unknown start, as a simulation's do: the trip counts from its arrival";

/// A lidar of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedLidar {
    /// What distinguishes it from the vehicle's other lidars; `None` of an only one.
    pub name: Option<LidarId>,
    /// Its geometry; `mount` is `base_from_lidar`.
    pub geometry: Lidar,
    /// Beams of every scan.
    pub beams: usize,
    /// From one beam to the next, seconds; 0 if it is not known.
    pub time_increment_s: f64,
    /// From one scan to the next, seconds; 0 if it is not known.
    pub scan_time_s: f64,
}

/// One scan of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedScan {
    /// When it was taken.
    pub stamp: StampNs,
    /// Where the odometry had the base.
    pub odom_from_base: Pose2,
    /// Metres, `None` for no return, 0 for an invalid reading.
    pub ranges_m: Vec<Option<f64>>,
}

/// The scans of one lidar, all of them in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct LidarLog {
    /// The lidar of every scan.
    pub lidar: Lidar,
    /// In order of time, strictly increasing.
    pub scans: Vec<RecordedScan>,
}

impl RecordedLidar {
    /// With its beam spacing multiplied by a factor, about the middle of the fan: for
    /// recordings that state the spacing wrongly.
    pub fn with_beam_spacing(mut self, factor: f64) -> Self {
        let half_fan = 0.5 * self.beams.saturating_sub(1) as f64;
        let lidar = &mut self.geometry;
        let spacing_rad = factor * lidar.angle_increment_rad;
        lidar.angle_min_rad += half_fan * (lidar.angle_increment_rad - spacing_rad);
        lidar.angle_increment_rad = spacing_rad;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_beam_spacing_keeps_the_middle_of_the_fan() {
        let lidar = RecordedLidar {
            name: None,
            geometry: Lidar {
                angle_min_rad: -0.1,
                angle_increment_rad: 0.1,
                range_min_m: 0.0,
                range_max_m: 5.0,
                mount: Pose2::IDENTITY,
                range_sigma_m: 0.01,
                band: None,
            },
            beams: 4,
            time_increment_s: 0.0,
            scan_time_s: 0.0,
        };
        let ends = |lidar: &RecordedLidar| {
            let geometry = &lidar.geometry;
            (geometry.beam_angle_rad(0), geometry.beam_angle_rad(3))
        };
        let (first_rad, last_rad) = ends(&lidar);
        let (narrow_first_rad, narrow_last_rad) = ends(&lidar.clone().with_beam_spacing(0.9));
        assert!((narrow_first_rad + narrow_last_rad - first_rad - last_rad).abs() < 1e-12);
        let ratio = (narrow_last_rad - narrow_first_rad) / (last_rad - first_rad);
        assert!((ratio - 0.9).abs() < 1e-12);
    }
}
