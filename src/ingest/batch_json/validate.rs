//! From fields to checked values. JSON has no NaN and no infinity, so every number is finite here;
//! NaN in [`raw::Numbers`] stands for null.

use std::f64::consts::PI;

use jiff::Timestamp;

use super::flags::flags;
use super::lidars::{self, Lidars, SendingLidar};
use super::ranges::RangeCounts;
use super::raw;
use super::uploaded::{BEAMS_TOTAL_MAX, SCANS_MAX, UploadedBatch};
use super::values::pose;
use crate::ingest::body_error::{BatchProblem, Checked, refuse};
use crate::ingest::extensions::Extensions;
use crate::ingest::json::Object;
use crate::mapping::{DriveScan, InitialPose};
use crate::scan::{LaserScan, ScanError};

const SIGMA_XY_DEFAULT_M: f64 = 0.5;
const SIGMA_XY_MAX_M: f64 = 100.0;
const SIGMA_THETA_DEFAULT_RAD: f64 = 0.2;

pub(super) fn batch(raw: raw::Batch, received_at: Timestamp) -> Checked<UploadedBatch> {
    let stated = lidars::stated(raw.lidar, raw.lidars)?;
    let initial_pose = raw.initial_pose.map(initial_pose).transpose()?;
    let extensions = raw.extensions.map(Extensions::checked).transpose()?;
    check_counts(&raw.scans)?;
    let mut lidars = Lidars::of(stated, &raw.scans.kept)?;
    let mut scans: Vec<DriveScan> = Vec::with_capacity(raw.scans.kept.len());
    let (mut ranges, mut has_clockwise) = (RangeCounts::default(), false);
    for (k, raw_scan) in raw.scans.kept.into_iter().enumerate() {
        let lidar = lidars.that_took(k, raw_scan.lidar.as_ref())?;
        let scan = scan(k, raw_scan, lidar, &mut ranges)?;
        has_clockwise |= lidar.is_clockwise;
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
        flags: flags(&scans, received_at, &ranges, has_clockwise),
        scans,
        ranges,
        extensions,
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

fn scan(
    k: usize,
    mut raw: raw::Scan,
    taken_by: &SendingLidar,
    counts: &mut RangeCounts,
) -> Checked<DriveScan> {
    let beams = taken_by.beams;
    let stamp = raw.stamp.checked(|| format!("/scans/{k}/stamp"))?;
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
    if taken_by.is_clockwise {
        raw.ranges.kept.reverse();
    }
    let ranges_m = raw.ranges.kept.iter().map(|r| (!r.is_nan()).then_some(*r));
    let scan = LaserScan::new(taken_by.geometry.clone(), ranges_m).or_else(|error| {
        refuse(
            BatchProblem::ScanGeometry,
            ranges_pointer(),
            error.to_string(),
        )
    })?;
    counts.add(&raw.ranges.kept, &scan);
    Ok(DriveScan {
        beam_interval_s: taken_by.beam_interval_s,
        lidar: taken_by.which.clone(),
        stamp,
        odom_from_base,
        scan,
    })
}
