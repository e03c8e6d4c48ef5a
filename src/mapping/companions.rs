//! Scans of a trip's companions, the lidars beside the one that takes its keyframes.

use super::drive::DriveScan;
use super::extend::Extension;
use super::intermediate::IntermediateScan;
use super::route_map::RouteMap;
use super::step::is_abrupt;
use crate::ids::TripId;
use crate::scan::KeyframeRule;

/// Two lidars' stamps nearer to each other than this, seconds, tell no speed.
const ELAPSED_MIN_S: f64 = 0.1;

impl RouteMap {
    /// Keeps a companion's scan that lends its points to no keyframe: behind its trip's last
    /// keyframe, by odometry from where the trip's last scan was taken. One that odometry puts where
    /// the trip cannot be by then says nothing.
    pub(super) fn add_companion(&mut self, trip: &TripId, scan: &DriveScan, added: &mut Extension) {
        let Some(&last) = self.trips.get(trip).and_then(|trip| trip.last()) else {
            return;
        };
        let keyframe = &self.keyframes[last];
        let primary = keyframe.scan.as_ref().unwrap_or(&scan.scan);
        let rule = KeyframeRule::for_range(primary.lidar().range_max_m);
        let before = keyframe.last_scan(&rule);
        let since = before.odom_from_base.between(&scan.odom_from_base);
        let elapsed_s = (scan.stamp.seconds() - before.stamp.seconds()).abs();
        let keyframes = self.trip_up_to(last).iter().map(|&k| &self.keyframes[k]);
        let is_known = keyframe.put_off_count(&rule) == 0
            && !is_abrupt(&since, elapsed_s.max(ELAPSED_MIN_S), keyframes);
        let keyframe_from_base = before.pose.compose(&since);
        let placed = IntermediateScan::of_companion(keyframe_from_base, scan, keyframe, is_known);
        self.keep_intermediate(last, placed, added);
    }
}
