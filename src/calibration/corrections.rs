//! A vehicle's errors, and what they make of its mount, its odometry and its scans.

use std::sync::Arc;

use super::{Estimates, OdometryTrack, Quantity};
use crate::geometry::{Pose2, Tangent2, Vector3};
use crate::scan::{LaserScan, Lidar, LidarError, ScanError};

/// A value for each [`Quantity`]; 0 where nothing is to be corrected.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Corrections {
    values: [f64; Quantity::ALL.len()],
}

impl Corrections {
    /// The values of estimates.
    pub fn of(estimates: &Estimates) -> Self {
        let mut corrections = Self::default();
        for (quantity, estimate) in estimates {
            corrections.set(*quantity, estimate.value);
        }
        corrections
    }

    /// In the quantity's unit.
    pub fn get(&self, quantity: Quantity) -> f64 {
        self.values[quantity as usize]
    }

    /// In the quantity's unit.
    pub fn set(&mut self, quantity: Quantity, value: f64) {
        self.values[quantity as usize] = value;
    }

    /// The same with another value.
    pub fn with(mut self, quantity: Quantity, value: f64) -> Self {
        self.set(quantity, value);
        self
    }

    /// `base_from_lidar` as it truly is, from the stated one.
    pub fn mount(&self, stated: &Pose2) -> Pose2 {
        stated.plus(&self.mount_step())
    }

    /// The true motion of the base, from the one by odometry: `base_from_base`.
    pub fn motion(&self, by_wheels: &Pose2) -> Pose2 {
        Pose2::exp(&self.twist(&by_wheels.log()))
    }

    /// The same for a tangent vector: both factors apply along the arc that was driven.
    pub(super) fn twist(&self, by_wheels: &Tangent2) -> Tangent2 {
        let way = 1.0 + self.get(Quantity::WayScale);
        let turn = 1.0 + self.get(Quantity::TurnScale);
        let turn_per_metre = self.get(Quantity::TurnPerMetre);
        Vector3::new(
            way * by_wheels.x,
            way * by_wheels.y,
            turn * by_wheels.z + turn_per_metre * by_wheels.x,
        )
    }

    /// The same for a whole track: from its first pose on, each motion is that of the wheels,
    /// corrected.
    pub fn track(&self, by_wheels: &OdometryTrack) -> OdometryTrack {
        let mut last: Option<(Pose2, Pose2)> = None;
        OdometryTrack::through(by_wheels.poses().iter().map(|(stamp, by_wheels)| {
            let pose = match last {
                None => *by_wheels,
                Some((before, corrected)) => {
                    corrected.compose(&self.motion(&before.between(by_wheels)))
                }
            };
            last = Some((*by_wheels, pose));
            (*stamp, pose)
        }))
    }

    /// Where odometry had the base when a scan of this stamp was taken. `None` without any pose.
    pub fn odometry_at(&self, track: &OdometryTrack, stamp_ns: i64) -> Option<Pose2> {
        track.at(stamp_ns.saturating_sub(self.clock_offset_ns()))
    }

    /// The clock offset, nanoseconds.
    pub(super) fn clock_offset_ns(&self) -> i64 {
        (1e9 * self.get(Quantity::ClockOffset)).round() as i64
    }

    /// The lidar with its true mount and beam spacing; `beams` is the number of a scan's beams.
    ///
    /// The middle of the fan keeps its direction. The spacing alone does not say which beam the
    /// stated angles are right of: about another beam, all bearings differ by one angle, which is a
    /// turn of the lidar on its mount. [`Quantity::MountYaw`] is measured with the spacing corrected
    /// about the middle, so that both together give the true bearings. About the middle, a wrong
    /// spacing turns what is seen by least, and the one can be corrected without the other.
    ///
    /// # Errors
    /// [`LidarError`] if there is no such lidar.
    pub fn lidar(&self, stated: &Lidar, beams: usize) -> Result<Lidar, LidarError> {
        let mount = self.mount(&stated.mount);
        let spaced = with_spacing(stated, beams, 1.0 + self.get(Quantity::BeamSpacing));
        Lidar { mount, ..spaced }.validated()
    }

    /// The lidar as it was stated, from one that [`Corrections::lidar`] made of it.
    ///
    /// # Errors
    /// [`LidarError`] if there is no such lidar.
    pub fn stated_lidar(&self, corrected: &Lidar, beams: usize) -> Result<Lidar, LidarError> {
        let mount = corrected.mount.plus(&-self.mount_step());
        let factor = 1.0 / (1.0 + self.get(Quantity::BeamSpacing));
        let spaced = with_spacing(corrected, beams, factor);
        Lidar { mount, ..spaced }.validated()
    }

    fn mount_step(&self) -> Vector3<f64> {
        Vector3::new(
            self.get(Quantity::MountX),
            self.get(Quantity::MountY),
            self.get(Quantity::MountYaw),
        )
    }

    /// A scan as the corrected lidar ([`Corrections::lidar`]) took it: its ranges are corrected too.
    ///
    /// # Errors
    /// [`ScanError`] if its beams go round more than once with the corrected spacing.
    pub fn scan(&self, scan: &LaserScan, corrected: &Arc<Lidar>) -> Result<LaserScan, ScanError> {
        let factor = 1.0 + self.get(Quantity::RangeScale);
        if factor == 1.0 {
            return LaserScan::from_ticks(corrected.clone(), scan.ticks());
        }
        scaled(scan, corrected, factor)
    }
}

/// The lidar with its beams so many times as far apart, about the middle of its fan.
pub(super) fn with_spacing(lidar: &Lidar, beams: usize, factor: f64) -> Lidar {
    let half_fan = 0.5 * beams.saturating_sub(1) as f64;
    let angle_increment_rad = factor * lidar.angle_increment_rad;
    Lidar {
        angle_min_rad: lidar.angle_min_rad
            + half_fan * (lidar.angle_increment_rad - angle_increment_rad),
        angle_increment_rad,
        ..lidar.clone()
    }
}

/// The scan with ranges so many times as long; what is invalid or without a return stays so.
pub(super) fn scaled(
    scan: &LaserScan,
    lidar: &Arc<Lidar>,
    factor: f64,
) -> Result<LaserScan, ScanError> {
    use crate::scan::{INVALID_TICK, NO_RETURN_TICK};
    let longest = f64::from(INVALID_TICK - 1);
    let to_tick = |tick: u16| match tick {
        NO_RETURN_TICK | INVALID_TICK => tick,
        ticks => (f64::from(ticks) * factor).round().clamp(1.0, longest) as u16,
    };
    let ticks: Vec<u16> = scan.ticks().iter().map(|tick| to_tick(*tick)).collect();
    LaserScan::from_ticks(lidar.clone(), ticks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::StampNs;
    use crate::scan::Reading;

    fn lidar() -> Lidar {
        Lidar {
            angle_min_rad: -1.0,
            angle_increment_rad: 0.02,
            range_min_m: 0.05,
            range_max_m: 10.0,
            mount: Pose2::new(0.2, 0.1, 0.5),
            range_sigma_m: 0.01,
            band: None,
        }
    }

    #[test]
    fn nothing_to_correct_leaves_all_as_it_is() {
        let none = Corrections::default();
        let motion = Pose2::new(0.5, -0.1, 0.7);
        let corrected = none.motion(&motion);
        assert!(motion.between(&corrected).log().norm() < 1e-12);
        assert_eq!(none.lidar(&lidar(), 101).unwrap(), lidar());
        let scan = LaserScan::new(lidar().into(), [Some(2.0), None]).unwrap();
        assert_eq!(none.scan(&scan, scan.lidar()).unwrap(), scan);
    }

    #[test]
    fn each_value_is_applied_where_it_belongs() {
        let some = Corrections::default()
            .with(Quantity::MountYaw, 0.1)
            .with(Quantity::MountX, 0.05)
            .with(Quantity::MountY, -0.02)
            .with(Quantity::WayScale, 0.01)
            .with(Quantity::TurnScale, 0.02)
            .with(Quantity::ClockOffset, 0.25)
            .with(Quantity::BeamSpacing, -0.1)
            .with(Quantity::RangeScale, 0.5);
        let stated = lidar();
        let corrected = Arc::new(some.lidar(&stated, 101).unwrap());
        assert_eq!(corrected.mount, Pose2::new(0.25, 0.1 - 0.02, 0.6));
        let back = some.stated_lidar(&corrected, 101).unwrap();
        assert!(back.mount.between(&stated.mount).log().norm() < 1e-12);
        for beam in [0, 50, 100] {
            let off_rad = back.beam_angle_rad(beam) - stated.beam_angle_rad(beam);
            assert!(off_rad.abs() < 1e-12, "{off_rad}");
        }
        assert!((corrected.beam_angle_rad(50) - stated.beam_angle_rad(50)).abs() < 1e-12);
        assert!((corrected.beam_angle_rad(0) + 0.9).abs() < 1e-12);
        let ranges = [Some(2.0), None, Some(f64::NAN)];
        let scan = some
            .scan(&LaserScan::new(stated.into(), ranges).unwrap(), &corrected)
            .unwrap();
        assert!((scan.range_m(0).unwrap() - 3.0).abs() < 1e-9);
        assert_eq!(scan.reading(1), Reading::NoReturn);
        assert_eq!(scan.reading(2), Reading::Invalid);
        let straight = some.motion(&Pose2::new(2.0, 0.0, 0.0));
        assert!(straight.between(&Pose2::new(2.02, 0.0, 0.0)).log().norm() < 1e-12);
        assert!((some.motion(&Pose2::new(0.0, 0.0, 1.0)).theta - 1.02).abs() < 1e-12);
        let at = |seconds: i64, x| (StampNs(seconds * 1_000_000_000), Pose2::new(x, 0.0, 0.0));
        let track = OdometryTrack::through([at(0, 0.0), at(2, 2.0)]);
        let pose = some.odometry_at(&track, 1_000_000_000).unwrap();
        assert!((pose.x - 0.75).abs() < 1e-9, "{pose:?}");
    }
}
