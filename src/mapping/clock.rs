//! A trip's odometry, put right by what its wheels err and by the offset between its clock and that
//! of the scans.
//!
//! Keyframes keep the odometry as it was sent. While a drive is walked its trip's have the odometry
//! of the time at which their scans were taken, since the next scan is placed by the difference.

use std::collections::BTreeMap;

use super::drive::{Drive, DriveScan};
use super::route_map::RouteMap;
use crate::calibration::{
    Corrections, DrivenPose, OdometryTrack, Quantity, clock_offset_s, way_scale,
};
use crate::geometry::Pose2;
use crate::ids::{LidarId, StampNs, TripId};
use crate::scan::SweepOrder;

/// So many of a trip's newest keyframes say what the offset is.
const KEYFRAMES_MAX: usize = 400;

/// What is like no other scan of its trip: when it was taken, and by which lidar.
type ScanKey = (StampNs, Option<LidarId>);

/// The odometry of one trip while a drive of it is walked.
pub struct TripClock {
    trip: TripId,
    /// As it was sent, of the trip's newest scans and the drive's.
    sent: BTreeMap<ScanKey, Pose2>,
    /// The same in the order of time.
    sent_track: OdometryTrack,
    /// What the vehicle's earlier trips are sure of.
    known_wheels: Corrections,
    /// What is corrected: that, and the scale of the way by this trip where they do not say it.
    wheels: Corrections,
    /// With the wheels corrected.
    track: OdometryTrack,
    /// Whether no two scans of a lidar share a stamp: where they do nothing is corrected.
    is_in_order: bool,
    offset_ns: i64,
}

impl TripClock {
    /// Of a drive that is about to be walked.
    pub fn new(map: &RouteMap, drive: &Drive) -> Self {
        let known = map.kept_odometry(&drive.trip).into_iter();
        let new = drive.scans.iter();
        let new = new.map(|s| ((s.stamp, s.lidar.name.clone()), s.odom_from_base));
        let all: Vec<(ScanKey, Pose2)> = known.chain(new).collect();
        let scans = all.len();
        let sent: BTreeMap<ScanKey, Pose2> = all.into_iter().collect();
        let by_stamp: BTreeMap<StampNs, Pose2> = sent
            .iter()
            .map(|((stamp, _), pose)| (*stamp, *pose))
            .collect();
        let sent_track = OdometryTrack::through(by_stamp);
        Self {
            trip: drive.trip.clone(),
            is_in_order: sent.len() == scans,
            known_wheels: drive.wheels,
            wheels: drive.wheels,
            track: corrected_track(&drive.wheels, &sent_track),
            sent_track,
            sent,
            offset_ns: 0,
        }
    }

    /// Asks the map for the offset, and corrects what the next scan is placed behind.
    pub fn adjust(&mut self, map: &mut RouteMap) {
        if !self.is_in_order {
            return;
        }
        self.restore(map);
        let driven = map.driven_poses(&self.trip);
        self.offset_ns = (1e9 * clock_offset_s(&driven)).round() as i64;
        if self.known_wheels.get(Quantity::WayScale) == 0.0 {
            let scale = way_scale(&driven);
            self.wheels = self.known_wheels.with(Quantity::WayScale, scale);
            self.track = corrected_track(&self.wheels, &self.sent_track);
        }
        if self.corrects() {
            map.set_odometry(&self.trip, |(stamp, _)| self.at(*stamp));
        }
    }

    /// A scan with the odometry of the time at which it was taken, and without the motion of the
    /// vehicle while it was.
    pub fn corrected(&self, scan: &DriveScan) -> DriveScan {
        let at = self.corrects().then(|| self.at(scan.stamp)).flatten();
        let swept = self.motion_during(scan);
        let order = match scan.beam_interval_s < 0.0 {
            true => SweepOrder::LastBeamFirst,
            false => SweepOrder::FirstBeamFirst,
        };
        DriveScan {
            odom_from_base: at.unwrap_or(scan.odom_from_base),
            scan: swept.map_or_else(
                || scan.scan.clone(),
                |motion| scan.scan.undistorted(&motion, order),
            ),
            lidar: scan.lidar.clone(),
            ..*scan
        }
    }

    /// The motion while the beams of a scan are taken; after the last odometry as fast as
    /// before it. `None` if no time passes between beams.
    fn motion_during(&self, scan: &DriveScan) -> Option<Pose2> {
        let beams = scan.scan.beam_count().saturating_sub(1);
        let sweep_ns = (1e9 * scan.beam_interval_s.abs() * beams as f64) as i64;
        if sweep_ns == 0 || !self.is_in_order {
            return None;
        }
        let start_ns = scan.stamp.0.saturating_sub(self.offset_ns);
        let (_, last) = self.track.span()?;
        match start_ns.saturating_add(sweep_ns) {
            end_ns if end_ns <= last.0 => self.track.motion(start_ns, end_ns),
            _ => self
                .track
                .motion(start_ns.saturating_sub(sweep_ns), start_ns),
        }
    }

    /// Gives the trip's keyframes their odometry back as it was sent.
    pub fn restore(&self, map: &mut RouteMap) {
        if self.corrects() {
            map.set_odometry(&self.trip, |key| self.sent.get(key).copied());
        }
    }

    /// Whether odometry is other than it was sent.
    fn corrects(&self) -> bool {
        self.is_in_order && (self.offset_ns != 0 || self.wheels != Corrections::default())
    }

    fn at(&self, stamp: StampNs) -> Option<Pose2> {
        self.track.at(stamp.0.saturating_sub(self.offset_ns))
    }
}

fn corrected_track(wheels: &Corrections, sent: &OdometryTrack) -> OdometryTrack {
    match *wheels == Corrections::default() {
        true => sent.clone(),
        false => wheels.track(sent),
    }
}

impl RouteMap {
    /// The newest scans of a trip's primary lidar, in the order of time; those between keyframes
    /// that were not matched have no pose by the map.
    fn driven_poses(&self, trip: &TripId) -> Vec<DrivenPose> {
        let places = self.trips.get(trip).map_or(&[][..], Vec::as_slice);
        let newest = &places[places.len().saturating_sub(KEYFRAMES_MAX)..];
        let mut poses = Vec::new();
        for &k in newest {
            let (keyframe, node) = (&self.keyframes[k], self.graph.nodes()[k]);
            poses.push(DrivenPose {
                stamp: keyframe.stamp,
                map_from_base: keyframe.scan.is_some().then_some(node.pose),
                odom_from_base: keyframe.odom_from_base,
            });
            poses.extend(keyframe.own_intermediate().map(|following| {
                DrivenPose {
                    stamp: following.stamp,
                    map_from_base: following
                        .scan
                        .is_some()
                        .then(|| node.pose.compose(&following.keyframe_from_base)),
                    odom_from_base: following.odom_from_base,
                }
            }));
        }
        poses
    }

    /// The odometry of the newest scans of a trip, of all its lidars.
    fn kept_odometry(&self, trip: &TripId) -> Vec<(ScanKey, Pose2)> {
        let places = self.trips.get(trip).map_or(&[][..], Vec::as_slice);
        let newest = &places[places.len().saturating_sub(KEYFRAMES_MAX)..];
        let mut kept = Vec::new();
        for keyframe in newest.iter().map(|&k| &self.keyframes[k]) {
            let own = (keyframe.stamp, keyframe.lidar.clone());
            kept.push((own, keyframe.odom_from_base));
            kept.extend(keyframe.intermediate.iter().map(|following| {
                let key = (following.stamp, keyframe.lidar_of(following).cloned());
                (key, following.odom_from_base)
            }));
        }
        kept
    }

    /// Sets the odometry of a trip's newest scans, where `odom_at` has one.
    fn set_odometry(&mut self, trip: &TripId, odom_at: impl Fn(&ScanKey) -> Option<Pose2>) {
        let places = self.trips.get(trip).map_or(&[][..], Vec::as_slice);
        let newest = &places[places.len().saturating_sub(KEYFRAMES_MAX)..];
        for &k in newest {
            let keyframe = &mut self.keyframes[k];
            let lidar = keyframe.lidar.clone();
            if let Some(odom_from_base) = odom_at(&(keyframe.stamp, lidar.clone())) {
                keyframe.odom_from_base = odom_from_base;
            }
            for following in &mut keyframe.intermediate {
                let taken_by = following.companion_lidar().or(lidar.as_ref()).cloned();
                if let Some(odom_from_base) = odom_at(&(following.stamp, taken_by)) {
                    following.odom_from_base = odom_from_base;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
