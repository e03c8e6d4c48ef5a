//! A part of one vehicle's drive, as it was uploaded.

use crate::calibration::Corrections;
use crate::geometry::Pose2;
use crate::ids::{LidarId, StampNs, TripId};
use crate::scan::LaserScan;

/// Consecutive scans of one trip.
#[derive(Debug, Clone)]
pub struct Drive {
    /// The trip: one odometry frame.
    pub trip: TripId,
    /// Where the first scan's base is, if the sender knows.
    pub initial_pose: Option<InitialPose>,
    /// In the order of time; of one lidar no two at the same.
    pub scans: Vec<DriveScan>,
    /// By what the wheels err. Odometry comes as it was sent and is kept so; the scans' lidars are
    /// those that are believed.
    pub wheels: Corrections,
}

/// Which of its vehicle's lidars took a scan.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LidarOfVehicle {
    /// As the vehicle names it; `None` for its only lidar.
    pub name: Option<LidarId>,
    /// Its place among the vehicle's lidars, 0 for the first.
    pub place: usize,
}

/// One scan with the odometry's word for where it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveScan {
    /// When it was taken.
    pub stamp: StampNs,
    /// Pose of the base in the vehicle's own odometry frame.
    pub odom_from_base: Pose2,
    /// From one beam to the next, seconds; below 0 if the last beam is taken first. The stamp is that
    /// of the beam that is taken first. 0 for a lidar that is taken to see everything at once.
    pub beam_interval_s: f64,
    /// Which lidar took it.
    pub lidar: LidarOfVehicle,
    /// What was seen.
    pub scan: LaserScan,
}

/// A rough pose in the map frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InitialPose {
    /// `map_from_base`.
    pub pose: Pose2,
    /// Standard deviation of x and of y, metres.
    pub sigma_xy_m: f64,
    /// Standard deviation of the heading, radians.
    pub sigma_theta_rad: f64,
}
