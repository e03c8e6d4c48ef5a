//! From fields to checked values. JSON has no NaN and no infinity, so every number is finite here;
//! NaN in [`raw::Numbers`] stands for null.

use std::f64::consts::PI;
use std::sync::Arc;

use jiff::Timestamp;

use super::flags::flags;
use super::raw;
use super::{
    BEAMS_TOTAL_MAX, BatchBodyError, BatchProblem, COORDINATE_MAX_M, SCANS_MAX, UploadedBatch,
};
use crate::formats::json::Object;
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::mapping::{DriveScan, InitialPose};
use crate::scan::{LaserScan, Lidar, LidarError, RANGE_SIGMA_DEFAULT_M, ScanError};

const SIGMA_XY_DEFAULT_M: f64 = 0.5;
const SIGMA_XY_MAX_M: f64 = 100.0;
const SIGMA_THETA_DEFAULT_RAD: f64 = 0.2;
/// A heading that was never wrapped still means something up to here, radians.
pub(in crate::formats) const HEADING_MAX_RAD: f64 = 1e4;
/// A sweep takes no longer than this, seconds …
const SCAN_TIME_MAX_S: f64 = 2.0;
/// … and no longer than the stated time between scans, with this for rounding.
const SCAN_TIME_SLACK: f64 = 1.05;
/// A range beyond this is a sentinel of some driver, not a measurement, metres.
const RANGE_ABSURD_M: f64 = 1e6;
/// 2000-01-01T00:00:00Z, seconds since the Unix epoch.
const STAMP_MIN_S: i64 = 946_684_800;
/// 2100-01-01T00:00:00Z, seconds since the Unix epoch.
const STAMP_MAX_S: i64 = 4_102_444_800;

/// What was checked, or the first mistake.
pub(in crate::formats) type Checked<T> = Result<T, BatchBodyError>;

pub(in crate::formats) fn refuse<T>(
    problem: BatchProblem,
    pointer: impl Into<String>,
    detail: String,
) -> Checked<T> {
    Err(BatchBodyError {
        problem,
        pointer: pointer.into(),
        detail,
    })
}

pub(super) fn batch(raw: raw::Batch, received_at: Timestamp) -> Checked<UploadedBatch> {
    let Object(raw_lidar) = raw.lidar;
    let angle_max_rad = raw_lidar.angle_max;
    let (time_increment_s, scan_time_s) = (raw_lidar.time_increment, raw_lidar.scan_time);
    let lidar = Arc::new(lidar(raw_lidar)?);
    let initial_pose = raw.initial_pose.map(initial_pose).transpose()?;
    check_counts(&raw.scans)?;
    let beams = raw.scans.kept.first().map_or(0, |scan| scan.ranges.count);
    check_angle_max(&lidar, angle_max_rad, beams)?;
    let beam_interval_s = beam_interval_s(&lidar, beams, time_increment_s, scan_time_s)?;
    let mut scans: Vec<DriveScan> = Vec::with_capacity(raw.scans.kept.len());
    for (k, raw_scan) in raw.scans.kept.into_iter().enumerate() {
        let scan = DriveScan {
            beam_interval_s,
            ..scan(k, raw_scan, &lidar, beams)?
        };
        if let Some(before) = scans.last()
            && scan.stamp <= before.stamp
        {
            return refuse(
                BatchProblem::TimestampOrder,
                format!("/scans/{k}/stamp"),
                "the stamps of a batch must increase strictly; this one is not after the one before it".into(),
            );
        }
        scans.push(scan);
    }
    Ok(UploadedBatch {
        vehicle_id: raw.vehicle_id,
        trip_id: raw.trip_id,
        sequence: i64::from(raw.sequence),
        initial_pose,
        flags: flags(&scans, received_at),
        scans,
    })
}

fn check_counts(scans: &raw::Scans) -> Checked<()> {
    if scans.beams > BEAMS_TOTAL_MAX {
        let detail = format!(
            "a batch has at most {BEAMS_TOTAL_MAX} beams in all scans together: send it in parts"
        );
        return refuse(BatchProblem::TooLarge, "/scans", detail);
    }
    if !(1..=SCANS_MAX).contains(&scans.count) {
        let detail = format!(
            "a batch has 1 to {SCANS_MAX} scans, this one has {}",
            scans.count
        );
        return refuse(BatchProblem::ScanGeometry, "/scans", detail);
    }
    Ok(())
}

fn lidar(raw: raw::Lidar) -> Checked<Lidar> {
    let mount = match raw.mount {
        Some(Object(mount)) => pose(mount, "/lidar/mount")?,
        None => Pose2::IDENTITY,
    };
    let lidar = Lidar {
        angle_min_rad: raw.angle_min,
        angle_increment_rad: raw.angle_increment,
        range_min_m: raw.range_min,
        range_max_m: raw.range_max,
        mount,
        range_sigma_m: raw.range_sigma.unwrap_or(RANGE_SIGMA_DEFAULT_M),
    };
    lidar.validated().or_else(|error| {
        let (problem, field) = match &error {
            LidarError::AngleMin(_) => (BatchProblem::ScanGeometry, "angle_min"),
            LidarError::AngleIncrement(_) => (BatchProblem::ScanGeometry, "angle_increment"),
            LidarError::RangeMin { .. } => (BatchProblem::ScanGeometry, "range_min"),
            LidarError::RangeMax(_) => (BatchProblem::ScanGeometry, "range_max"),
            LidarError::Mount => (BatchProblem::OutOfRange, "mount"),
            LidarError::RangeSigma(_) => (BatchProblem::OutOfRange, "range_sigma"),
        };
        refuse(problem, format!("/lidar/{field}"), error.to_string())
    })
}

/// `angle_max` may be left out; where it is sent it must fit the beams to within one.
fn check_angle_max(lidar: &Lidar, angle_max_rad: Option<f64>, beams: usize) -> Checked<()> {
    let Some(angle_max_rad) = angle_max_rad else {
        return Ok(());
    };
    let covered_rad = angle_max_rad - lidar.angle_min_rad;
    let expected = covered_rad / lidar.angle_increment_rad + 1.0;
    let detail = if covered_rad <= 0.0 {
        format!(
            "angle_max {angle_max_rad} must be above angle_min {}",
            lidar.angle_min_rad
        )
    } else if (expected - beams as f64).abs() > 1.5 {
        format!(
            "angle_min, angle_max and angle_increment make {expected:.0} beams, the scans have {beams}"
        )
    } else {
        return Ok(());
    };
    refuse(BatchProblem::ScanGeometry, "/lidar/angle_max", detail)
}

/// `time_increment` if it is sent; else that of a lidar that turns once in `scan_time`; else 0.
fn beam_interval_s(
    lidar: &Lidar,
    beams: usize,
    time_increment_s: Option<f64>,
    scan_time_s: Option<f64>,
) -> Checked<f64> {
    if let Some(scan_time_s) = scan_time_s
        && !(0.0..=SCAN_TIME_MAX_S).contains(&scan_time_s)
    {
        let detail = format!("scan_time {scan_time_s} is not within 0 to {SCAN_TIME_MAX_S} s");
        return refuse(BatchProblem::OutOfRange, "/lidar/scan_time", detail);
    }
    let per_turn_s = scan_time_s.unwrap_or(0.0);
    let interval_s =
        time_increment_s.unwrap_or(per_turn_s * lidar.angle_increment_rad / (2.0 * PI));
    let sweep_s = interval_s * beams.saturating_sub(1) as f64;
    let longest_s = match scan_time_s {
        Some(scan_time_s) if scan_time_s > 0.0 => SCAN_TIME_SLACK * scan_time_s,
        _ => SCAN_TIME_MAX_S,
    };
    if interval_s >= 0.0 && sweep_s <= longest_s {
        return Ok(interval_s);
    }
    let detail = format!(
        "time_increment {interval_s} for {beams} beams makes a scan of {sweep_s:.3} s, which is \
         not within 0 to {longest_s:.3} s: it is the time from one beam to the next, in seconds"
    );
    refuse(BatchProblem::OutOfRange, "/lidar/time_increment", detail)
}

fn initial_pose(Object(raw): Object<raw::InitialPose>) -> Checked<InitialPose> {
    let sigma_xy_m = raw.sigma_xy.unwrap_or(SIGMA_XY_DEFAULT_M);
    if !(sigma_xy_m > 0.0 && sigma_xy_m <= SIGMA_XY_MAX_M) {
        let detail = format!("sigma_xy {sigma_xy_m} is not within (0, {SIGMA_XY_MAX_M}] m");
        return refuse(BatchProblem::OutOfRange, "/initial_pose/sigma_xy", detail);
    }
    let sigma_theta_rad = raw.sigma_theta.unwrap_or(SIGMA_THETA_DEFAULT_RAD);
    if !(sigma_theta_rad > 0.0 && sigma_theta_rad <= PI) {
        let detail =
            format!("sigma_theta {sigma_theta_rad} is not within (0, π]: did you send degrees?");
        return refuse(
            BatchProblem::OutOfRange,
            "/initial_pose/sigma_theta",
            detail,
        );
    }
    let fields = raw::Pose {
        x: raw.x,
        y: raw.y,
        theta: raw.theta,
    };
    Ok(InitialPose {
        pose: pose(fields, "/initial_pose")?,
        sigma_xy_m,
        sigma_theta_rad,
    })
}

fn pose(raw: raw::Pose, pointer: &str) -> Checked<Pose2> {
    for (field, value) in [("x", raw.x), ("y", raw.y)] {
        if value.abs() > COORDINATE_MAX_M {
            let detail = format!(
                "{field} {value} is not within ±{COORDINATE_MAX_M} m: send metres in a frame near the vehicle"
            );
            return refuse(
                BatchProblem::OutOfRange,
                format!("{pointer}/{field}"),
                detail,
            );
        }
    }
    if raw.theta.abs() > HEADING_MAX_RAD {
        let detail = format!(
            "theta {} is not within ±{HEADING_MAX_RAD} rad: send radians",
            raw.theta
        );
        return refuse(BatchProblem::OutOfRange, format!("{pointer}/theta"), detail);
    }
    Ok(Pose2::new(raw.x, raw.y, raw.theta))
}

fn scan(k: usize, raw: raw::Scan, lidar: &Arc<Lidar>, beams: usize) -> Checked<DriveScan> {
    let stamp = stamp(raw.stamp, format!("/scans/{k}/stamp"))?;
    let odom_from_base = pose(raw.odometry.0, &format!("/scans/{k}/odometry"))?;
    let ranges_pointer = || format!("/scans/{k}/ranges");
    if raw.ranges.count != beams {
        let detail = format!(
            "all scans of a batch have the same number of beams: the first has {beams}, this one {}",
            raw.ranges.count
        );
        return refuse(BatchProblem::ScanGeometry, ranges_pointer(), detail);
    }
    if raw.ranges.count > raw.ranges.kept.len() {
        let detail = ScanError::BeamCount(raw.ranges.count).to_string();
        return refuse(BatchProblem::ScanGeometry, ranges_pointer(), detail);
    }
    if let Some(intensities) = raw.intensities
        && ![0, beams].contains(&intensities.count)
    {
        let detail = format!(
            "{} intensities for {beams} ranges: send one each, or leave them out",
            intensities.count
        );
        return refuse(
            BatchProblem::ScanGeometry,
            format!("/scans/{k}/intensities"),
            detail,
        );
    }
    check_ranges(k, &raw.ranges.kept)?;
    let ranges_m = raw.ranges.kept.iter().map(|r| (!r.is_nan()).then_some(*r));
    let scan = LaserScan::new(lidar.clone(), ranges_m).or_else(|error| {
        refuse(
            BatchProblem::ScanGeometry,
            ranges_pointer(),
            error.to_string(),
        )
    })?;
    Ok(DriveScan {
        beam_interval_s: 0.0,
        stamp,
        odom_from_base,
        scan,
    })
}

fn check_ranges(k: usize, ranges_m: &[f64]) -> Checked<()> {
    for (beam, &range_m) in ranges_m.iter().enumerate() {
        if !range_m.is_nan() && !(0.0..=RANGE_ABSURD_M).contains(&range_m) {
            return refuse(
                BatchProblem::OutOfRange,
                format!("/scans/{k}/ranges/{beam}"),
                format!("{range_m} is no range in metres: send null for no return"),
            );
        }
    }
    Ok(())
}

/// A time as it is kept.
///
/// # Errors
/// [`BatchProblem::OutOfRange`] at the pointer, if it is not between 2000 and 2100.
pub(in crate::formats) fn stamp(stamp: Timestamp, pointer: String) -> Checked<StampNs> {
    let nanoseconds = i64::try_from(stamp.as_nanosecond()).ok();
    match nanoseconds {
        Some(ns) if (STAMP_MIN_S..STAMP_MAX_S).contains(&stamp.as_second()) => Ok(StampNs(ns)),
        _ => refuse(
            BatchProblem::OutOfRange,
            pointer,
            format!("{stamp} is not between 2000 and 2100: is the vehicle's clock set?"),
        ),
    }
}
