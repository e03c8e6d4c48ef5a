//! Scans with their places in the map.

use std::collections::BTreeMap;

use super::recording::Recording;
use crate::geometry::{Pose2, Vector2};
use crate::ids::StampNs;
use crate::ingest::RecordedScan;
use crate::scan::Lidar;

/// A scan, its lidar, and where the map has it.
pub(super) struct PlacedScan<'a> {
    pub lidar: &'a Lidar,
    pub scan: &'a RecordedScan,
    pub map_from_base: Pose2,
    pub map_from_lidar: Pose2,
}

impl PlacedScan<'_> {
    /// Unit vectors along the beams, map frame.
    pub(super) fn directions(&self) -> impl Iterator<Item = Vector2<f64>> {
        let turn = self.map_from_lidar.to_transform();
        let beams = self.lidar.beam_directions(self.scan.ranges_m.len());
        beams.map(move |direction| turn.turn(&direction))
    }

    /// The returns, map frame, metres.
    pub(super) fn hits(&self) -> impl Iterator<Item = Vector2<f64>> {
        let eye = self.map_from_lidar.translation();
        let beams = self.directions().zip(&self.scan.ranges_m);
        beams.filter_map(move |(direction, range_m)| Some(eye + direction * (*range_m)?))
    }

    /// The beams that may meet something within a circle, as places in the fan; a beam more on
    /// either side.
    pub(super) fn beams_towards(&self, middle: &Vector2<f64>, radius_m: f64) -> Vec<usize> {
        let beams = self.scan.ranges_m.len();
        let seen = self.map_from_lidar.inverse().transform(middle);
        let distance_m = seen.norm();
        if distance_m - radius_m > self.lidar.range_max_m {
            return Vec::new();
        }
        if distance_m <= radius_m {
            return (0..beams).collect();
        }
        let half_rad = (radius_m / distance_m).asin() + self.lidar.angle_increment_rad;
        let bearing_rad = seen.y.atan2(seen.x);
        let mut towards = Vec::new();
        // A fan may begin anywhere within two turns.
        for turns in -2..=2 {
            let middle_rad = bearing_rad + f64::from(turns) * std::f64::consts::TAU;
            let place = |angle_rad: f64| {
                (angle_rad - self.lidar.angle_min_rad) / self.lidar.angle_increment_rad
            };
            let first = place(middle_rad - half_rad).ceil().max(0.0);
            let last = place(middle_rad + half_rad).floor().min(beams as f64 - 1.0);
            if first <= last {
                towards.extend(first as usize..=last as usize);
            }
        }
        towards.sort_unstable();
        towards.dedup();
        towards
    }
}

/// The scans that have a place, in the order of time.
pub(super) fn placed_scans<'a>(
    recordings: &'a [Recording],
    poses: &BTreeMap<StampNs, Pose2>,
) -> Vec<PlacedScan<'a>> {
    let scans = recordings.iter().flat_map(|recording| {
        let lidar: &Lidar = &recording.lidar;
        recording.scans.iter().map(move |scan| (lidar, scan))
    });
    let placed = scans.filter_map(|(lidar, scan)| {
        let map_from_base = *poses.get(&scan.stamp)?;
        Some(PlacedScan {
            lidar,
            scan,
            map_from_base,
            map_from_lidar: map_from_base.compose(&lidar.mount),
        })
    });
    placed.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_towards_a_circle_are_those_that_cross_it() {
        let lidar = Lidar {
            angle_min_rad: -2.0,
            angle_increment_rad: 0.01,
            range_min_m: 0.0,
            range_max_m: 10.0,
            mount: Pose2::IDENTITY,
            range_sigma_m: 0.01,
            band: None,
        };
        let scan = RecordedScan {
            stamp: StampNs(0),
            odom_from_base: Pose2::IDENTITY,
            ranges_m: vec![None; 401],
        };
        let placed = PlacedScan {
            lidar: &lidar,
            scan: &scan,
            map_from_base: Pose2::IDENTITY,
            map_from_lidar: Pose2::new(1.0, 2.0, 2.5),
        };
        for bearing_rad in [-3.0_f64, -1.0, 0.3, 1.9, 3.1] {
            let along = Vector2::new(bearing_rad.cos(), bearing_rad.sin());
            let middle = placed.map_from_lidar.transform(&(along * 3.0));
            let eye = placed.map_from_lidar.translation();
            let crosses = |direction: &Vector2<f64>| {
                let to = middle - eye;
                to.dot(direction) > 0.0 && direction.perp(&to).abs() < 0.4
            };
            let towards = placed.beams_towards(&middle, 0.4);
            for (k, direction) in placed.directions().enumerate() {
                assert!(
                    !crosses(&direction) || towards.contains(&k),
                    "{bearing_rad} {k}"
                );
            }
            assert!(towards.len() < 32);
        }
    }
}
