//! A trip's odometry, put right by what its wheels err and by the offset between its clock and that
//! of the scans.
//!
//! Keyframes keep the odometry as it was sent. While a drive is walked its trip's have the odometry
//! of the time at which their scans were taken, since the next scan is placed by the difference.

use std::collections::BTreeMap;

use super::drive::{Drive, DriveScan};
use super::route_map::{RouteMap, Weighting};
use crate::calibration::{
    Corrections, DrivenPose, DrivenStep, OdometryTrack, Quantity, clock_offset_s, way_scale,
};
use crate::geometry::Pose2;
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{LidarId, StampNs, TripId};
use crate::scan::SweepOrder;

/// So many of a trip's newest keyframes say what the offset is.
const KEYFRAMES_MAX: usize = 400;
/// The scale of the way is asked for anew after so many keyframes, …
const KEYFRAMES_PER_SCALE: u32 = 25;
/// … of so many of the newest.
const SCALE_KEYFRAMES_MAX: u32 = 300;

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
    /// The wheels are corrected by so many of the trip's first keyframes.
    keyframes_asked: u32,
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
            keyframes_asked: 0,
        }
    }

    /// Asks the map for the offset, and corrects what the next scan is placed behind.
    pub fn adjust(&mut self, map: &mut RouteMap) {
        if !self.is_in_order {
            return;
        }
        self.restore(map);
        let offset_s = clock_offset_s(&map.driven_poses(&self.trip));
        self.offset_ns = (1e9 * offset_s).round() as i64;
        self.adjust_way(map);
    }

    /// Asks the map how much too long the wheels have the way, once the trip has so many keyframes
    /// more: whatever batches it comes in, it is asked at the same ones.
    pub fn follow(&mut self, map: &mut RouteMap) {
        if self.is_in_order && self.keyframes_asked != map.keyframes_to_ask(&self.trip) {
            self.restore(map);
            self.adjust_way(map);
        }
    }

    /// Of a map that has the odometry as it was sent.
    fn adjust_way(&mut self, map: &mut RouteMap) {
        self.keyframes_asked = map.keyframes_to_ask(&self.trip);
        let is_known = self.known_wheels.get(Quantity::WayScale) != 0.0;
        if !is_known && map.weighting == Weighting::Robust {
            let scale = way_scale(&map.driven_steps(&self.trip, self.keyframes_asked));
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

    /// The steps between a trip's keyframes up to one of that order, as they were measured: where the
    /// map has moved them since says the same of wheels, and would differ from batch to batch.
    fn driven_steps(&self, trip: &TripId, before_order: u32) -> Vec<DrivenStep> {
        let places = self.trips.get(trip).map_or(&[][..], Vec::as_slice);
        let from_order = before_order.saturating_sub(SCALE_KEYFRAMES_MAX);
        let is_asked =
            |k: &&usize| (from_order..before_order).contains(&self.keyframes[**k].trip_order);
        let newest = &places[places.len().saturating_sub(KEYFRAMES_MAX)..];
        let asked: Vec<usize> = newest.iter().filter(is_asked).copied().collect();
        let steps = asked.windows(2).map(|two| {
            let [from, to] = [two[0], two[1]].map(|k| self.keyframes[k].odom_from_base);
            DrivenStep {
                by_scans: self.measured_step(two[0], two[1]),
                by_wheels: from.between(&to),
            }
        });
        steps.collect()
    }

    /// What the odometry edge between two keyframes measured; `None` if there is none.
    fn measured_step(&self, from: usize, to: usize) -> Option<Pose2> {
        let edges = self.graph.incident(to).iter();
        let mut edges = edges.map(|&edge| (&self.graph.edges()[edge], self.graph.ends()[edge]));
        let step = edges.find(|(edge, ends)| {
            edge.kind == EdgeKind::Odometry
                && edge.status == EdgeStatus::Active
                && *ends == (from, to)
        });
        Some(step?.0.measurement)
    }

    /// How many of a trip's first keyframes say how long its way is: a multiple of twenty-five.
    fn keyframes_to_ask(&self, trip: &TripId) -> u32 {
        let newest = self.trips.get(trip).and_then(|trip| trip.last());
        let driven = newest.map_or(0, |&k| self.keyframes[k].trip_order + 1);
        driven - driven % KEYFRAMES_PER_SCALE
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
