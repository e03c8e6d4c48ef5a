//! From fields to checked values. JSON has no NaN and no infinity, so every number is finite here;
//! NaN in [`raw::Numbers`] stands for null.

use std::f64::consts::PI;

use jiff::Timestamp;

use super::flags::flags;
use super::lidars::{self, Lidars, SendingLidar};
use super::raw;
use super::{
    BEAMS_TOTAL_MAX, BatchBodyError, BatchProblem, COORDINATE_MAX_M, SCANS_MAX, UploadedBatch,
};
use crate::geometry::Pose2;
use crate::ids::StampNs;
use crate::ingest::json::Object;
use crate::mapping::{DriveScan, InitialPose};
use crate::scan::{
    BandError, BandView, HeightBand, LaserScan, Lidar, LidarError, RANGE_SIGMA_DEFAULT_M, ScanError,
};

const SIGMA_XY_DEFAULT_M: f64 = 0.5;
const SIGMA_XY_MAX_M: f64 = 100.0;
const SIGMA_THETA_DEFAULT_RAD: f64 = 0.2;
/// A heading that was never wrapped still means something up to here, radians.
pub(in crate::ingest) const HEADING_MAX_RAD: f64 = 1e4;
/// A range beyond this is a sentinel of some driver, not a measurement, metres.
const RANGE_ABSURD_M: f64 = 1e6;
/// 2000-01-01T00:00:00Z, seconds since the Unix epoch.
const STAMP_MIN_S: i64 = 946_684_800;
/// 2100-01-01T00:00:00Z, seconds since the Unix epoch.
const STAMP_MAX_S: i64 = 4_102_444_800;

/// What was checked, or the first mistake.
pub(in crate::ingest) type Checked<T> = Result<T, BatchBodyError>;

pub(in crate::ingest) fn refuse<T>(
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
    let stated = lidars::stated(raw.lidar, raw.lidars)?;
    let initial_pose = raw.initial_pose.map(initial_pose).transpose()?;
    check_counts(&raw.scans)?;
    let mut lidars = Lidars::of(stated, &raw.scans.kept)?;
    let mut scans: Vec<DriveScan> = Vec::with_capacity(raw.scans.kept.len());
    for (k, raw_scan) in raw.scans.kept.into_iter().enumerate() {
        let lidar = lidars.that_took(k, raw_scan.lidar.as_ref())?;
        let scan = scan(k, raw_scan, lidar)?;
        lidar.check_stamp(k, scan.stamp)?;
        if let Some(before) = scans.last()
            && scan.stamp < before.stamp
        {
            return refuse(
                BatchProblem::TimestampOrder,
                format!("/scans/{k}/stamp"),
                "the scans of a batch must be in the order of time, whichever lidar took them; this one was taken before the one it follows".into(),
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

/// The lidar stated at a pointer.
pub(super) fn lidar(raw: raw::Lidar, pointer: &str) -> Checked<Lidar> {
    let mount = match raw.mount {
        Some(Object(mount)) => pose(mount, &format!("{pointer}/mount"))?,
        None => Pose2::IDENTITY,
    };
    let lidar = Lidar {
        angle_min_rad: raw.angle_min,
        angle_increment_rad: raw.angle_increment,
        range_min_m: raw.range_min,
        range_max_m: raw.range_max,
        mount,
        range_sigma_m: raw.range_sigma.unwrap_or(RANGE_SIGMA_DEFAULT_M),
        band: raw.band.map(|band| band_view(&band.0, raw.range_max)),
    };
    lidar.validated().or_else(|error| {
        let (problem, field) = match &error {
            LidarError::AngleMin(_) => (BatchProblem::ScanGeometry, "angle_min"),
            LidarError::AngleIncrement(_) => (BatchProblem::ScanGeometry, "angle_increment"),
            LidarError::RangeMin { .. } => (BatchProblem::ScanGeometry, "range_min"),
            LidarError::RangeMax(_) => (BatchProblem::ScanGeometry, "range_max"),
            LidarError::Mount => (BatchProblem::OutOfRange, "mount"),
            LidarError::RangeSigma(_) => (BatchProblem::OutOfRange, "range_sigma"),
            LidarError::Band(error) => (BatchProblem::OutOfRange, band_field(error)),
        };
        refuse(problem, format!("{pointer}/{field}"), error.to_string())
    })
}

fn band_view(raw: &raw::Band, range_max_m: f64) -> BandView {
    let band = HeightBand {
        from_m: raw.from,
        to_m: raw.to,
    };
    let all_the_way = BandView::all_the_way(band, range_max_m);
    BandView {
        clear_from_m: raw.clear_from.unwrap_or(all_the_way.clear_from_m),
        clear_to_m: raw.clear_to.unwrap_or(all_the_way.clear_to_m),
        ..all_the_way
    }
}

fn band_field(error: &BandError) -> &'static str {
    match error {
        BandError::Height { .. } | BandError::Thin { .. } => "band",
        BandError::Clear { .. } => "band/clear_from",
    }
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

fn scan(k: usize, raw: raw::Scan, taken_by: &SendingLidar) -> Checked<DriveScan> {
    let beams = taken_by.beams;
    let stamp = stamp(raw.stamp, format!("/scans/{k}/stamp"))?;
    let odom_from_base = pose(raw.odometry.0, &format!("/scans/{k}/odometry"))?;
    let ranges_pointer = || format!("/scans/{k}/ranges");
    if raw.ranges.count != beams {
        let detail = format!(
            "all scans of {} have the same number of beams: the first has {beams}, this one {}",
            taken_by.scans_of(),
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
    let scan = LaserScan::new(taken_by.geometry.clone(), ranges_m).or_else(|error| {
        refuse(
            BatchProblem::ScanGeometry,
            ranges_pointer(),
            error.to_string(),
        )
    })?;
    Ok(DriveScan {
        beam_interval_s: taken_by.beam_interval_s,
        lidar: taken_by.which.clone(),
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
pub(in crate::ingest) fn stamp(stamp: Timestamp, pointer: String) -> Checked<StampNs> {
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
