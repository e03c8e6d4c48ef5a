//! Estimates a trip's calibration once the map keeps enough of its scans, and again with many.

mod map_comparison;
mod trip_in_map;

use std::collections::BTreeMap;

use self::map_comparison::beside_others;
pub(super) use self::trip_in_map::TripInMap;
use super::vehicles::{as_stated, base_from_stated};
use crate::calibration::{CompanionScan, TripCalibration, TripCorrections, TripScan};
use crate::geometry::Pose2;
use crate::ids::{LidarId, TripId};
use crate::mapping::{Keyframe, RouteMap};
use crate::scan::{LaserScan, SurfacePoint, surface_points};
use crate::store::TripCalibrationRecord;

/// A trip is calibrated when the map keeps this many of its scans. Each costs about half a millisecond.
const SCANS: [usize; 2] = [150, 600];
/// This many of a companion's scans are compared with the primary lidar's points …
const COMPANIONS_MAX: usize = 60;
/// … at every `AROUND_STEP`-th of `AROUND` keyframes before and after. Each costs a few milliseconds.
const AROUND_STEP: usize = 2;
const AROUND: usize = 12;

/// How many scans of each of a trip's lidars the map keeps. A vehicle's only lidar has no name.
pub(super) type KeptScans = BTreeMap<Option<LidarId>, usize>;

impl TripInMap<'_> {
    /// Calibrates each of the trip's lidars that is due: the number of its scans in the map, which was
    /// `known` before, has reached one of [`SCANS`].
    ///
    /// Odometry is stored as sent, and the corrections of the scans are undone first, so that no correction
    /// is estimated on top of itself. Scans of other lidars are used as the map has them.
    pub fn calibrations(&self, known: &KeptScans) -> Vec<TripCalibrationRecord> {
        let Self {
            map,
            trip,
            corrections,
            ..
        } = *self;
        let due = kept_scans(map, trip).into_iter().filter(|(lidar, count)| {
            let known = known.get(lidar).copied().unwrap_or(0);
            SCANS.iter().any(|due| known < *due && due <= count)
        });
        let record = |(lidar, _): (Option<LidarId>, usize)| {
            let scans = scans_of(map, trip, lidar.as_ref(), corrections);
            let calibration = TripCalibration::of_scans(&scans);
            Some(TripCalibrationRecord {
                trip_id: trip.clone(),
                vehicle_id: self.vehicle.clone(),
                stamp: scans.last()?.stamp,
                scans: u32::try_from(scans.len()).ok()?,
                calibration: beside_others(self, lidar.as_ref(), calibration),
                beside_primary: lidar
                    .as_ref()
                    .and_then(|lidar| beside_primary(map, trip, lidar, corrections)),
                lidar,
            })
        };
        due.filter_map(record).collect()
    }
}

/// How many of a trip's scans the map keeps.
pub(super) fn kept_scans(map: &RouteMap, trip: &TripId) -> KeptScans {
    let mut kept = KeptScans::new();
    for keyframe in map.keyframes().iter().filter(|k| k.trip == *trip) {
        if keyframe.scan.is_some() {
            *kept.entry(keyframe.lidar.clone()).or_default() += 1;
        }
        for following in keyframe.intermediate.iter().filter(|s| s.scan.is_some()) {
            *kept
                .entry(keyframe.lidar_of(following).cloned())
                .or_default() += 1;
        }
    }
    kept
}

/// The scans of one of the trip's lidars in the order of time, without those that another lidar geometry
/// than the first one's took.
fn scans_of(
    map: &RouteMap,
    trip: &TripId,
    lidar: Option<&LidarId>,
    corrections: &TripCorrections,
) -> Vec<TripScan> {
    let of_lidar = corrections.of_lidar(lidar);
    let keyframes = map.keyframes().iter().filter(|k| k.trip == *trip);
    let scans = keyframes.flat_map(|keyframe| {
        let own = (
            keyframe.lidar.as_ref(),
            keyframe.stamp,
            keyframe.odom_from_base,
            keyframe.scan.as_ref(),
        );
        let between = keyframe.intermediate.iter().map(|s| {
            let lidar = keyframe.lidar_of(s);
            (lidar, s.stamp, s.odom_from_base, s.scan.as_ref())
        });
        std::iter::once(own).chain(between)
    });
    let scans = scans.filter(|(taken_by, ..)| *taken_by == lidar);
    let scans = scans.filter_map(|(_, stamp, odom_from_base, scan)| {
        Some(TripScan {
            stamp,
            odom_from_base,
            scan: as_stated(scan?, &of_lidar)?,
        })
    });
    let mut scans: Vec<TripScan> = scans.collect();
    scans.sort_by_key(|scan| scan.stamp);
    if let Some(first) = scans.first().map(|scan| scan.scan.clone()) {
        let is_alike = |scan: &LaserScan| {
            scan.lidar() == first.lidar() && scan.beam_count() == first.beam_count()
        };
        scans.retain(|scan| is_alike(&scan.scan));
    }
    scans
}

/// A trip's localised keyframe with the points of its lidar.
struct Around<'a> {
    keyframe: &'a Keyframe,
    map_from_base: Pose2,
    points: Vec<SurfacePoint>,
}

/// The mount of a companion relative to the lidar that takes the trip's keyframes; `None` if the companion is
/// that lidar.
fn beside_primary(
    map: &RouteMap,
    trip: &TripId,
    lidar: &LidarId,
    corrections: &TripCorrections,
) -> Option<TripCalibration> {
    let keyframes = map.keyframes().iter().zip(map.graph().nodes());
    let keyframes = keyframes.filter(|(keyframe, _)| keyframe.trip == *trip && !keyframe.is_lost());
    let around = keyframes.filter_map(|(keyframe, node)| {
        Some(Around {
            keyframe,
            map_from_base: node.pose.compose(&base_from_stated(keyframe, corrections)?),
            points: surface_points(&as_stated(
                keyframe.scan.as_ref()?,
                &corrections.of_lidar(keyframe.lidar.as_ref()),
            )?),
        })
    });
    let around: Vec<Around<'_>> = around.collect();
    if around.last()?.keyframe.lidar.as_ref() == Some(lidar) {
        return None;
    }
    let companions = around.iter().enumerate().flat_map(|(k, at)| {
        let of_lidar = at.keyframe.intermediate.iter();
        let of_lidar = of_lidar.filter(|s| s.companion_lidar() == Some(lidar));
        of_lidar.filter_map(move |s| {
            let as_seen = base_from_stated(at.keyframe, corrections)?;
            let map_from_keyframe = at.map_from_base.compose(&as_seen.inverse());
            let map_from_base = map_from_keyframe.compose(&s.keyframe_from_base);
            let stated = as_stated(s.scan.as_ref()?, &corrections.of_lidar(Some(lidar)))?;
            Some((k, map_from_base.compose(&as_seen), stated))
        })
    });
    let companions: Vec<(usize, Pose2, LaserScan)> = companions.collect();
    let every = companions.len().div_ceil(COMPANIONS_MAX).max(1);
    let companions = companions.iter().step_by(every).map(|(k, pose, scan)| {
        let near = k.saturating_sub(AROUND)..(k + AROUND + 1).min(around.len());
        let near = around[near].iter().step_by(AROUND_STEP);
        let near = near.map(|other| (pose.between(&other.map_from_base), other.points.as_slice()));
        CompanionScan {
            scan,
            around: near.collect(),
        }
    });
    Some(TripCalibration::of_companion(companions))
}

#[cfg(test)]
mod tests;
