//! A lidar that looks into a simulated world.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::World;
use super::random::normal;
use crate::geometry::{Pose2, Vector2};
use crate::scan::Lidar;

/// A lidar with its faults.
#[derive(Debug, Clone, PartialEq)]
pub struct SimLidar {
    /// Its geometry; `range_sigma_m` is the noise of every range.
    pub geometry: Lidar,
    /// Beams of a scan.
    pub beams: usize,
    /// Share of the beams that give no return though something is there.
    pub dropout_rate: f64,
}

impl SimLidar {
    /// All round, evenly spread beams, the last one beam short of a full turn.
    pub fn all_round(beams: usize, range_max_m: f64, range_sigma_m: f64, mount: Pose2) -> Self {
        let turn_rad = std::f64::consts::TAU;
        Self {
            geometry: Lidar {
                angle_min_rad: -0.5 * turn_rad,
                angle_increment_rad: turn_rad / beams as f64,
                range_min_m: 0.05,
                range_max_m,
                mount,
                range_sigma_m,
            },
            beams,
            dropout_rate: 0.0,
        }
    }

    /// One scan: metres to the millimetre, `None` for no return.
    pub(super) fn scan(
        &self,
        world: &World,
        map_from_base: &Pose2,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Option<f64>> {
        let map_from_lidar = map_from_base.compose(&self.geometry.mount);
        let eye = map_from_lidar.translation();
        let beam = |k| {
            let (sin, cos) = (map_from_lidar.theta + self.geometry.beam_angle_rad(k)).sin_cos();
            let hit = world.cast(&eye, &Vector2::new(cos, sin));
            // Drawn for every beam, so that a change in the world leaves the noise of the
            // other beams as it was.
            let noise_m = normal(rng, self.geometry.range_sigma_m);
            let dropped = rng.random::<f64>() < self.dropout_rate;
            let range_m = ((hit?.range_m + noise_m) * 1e3).round() / 1e3;
            let seen = (self.geometry.range_min_m..self.geometry.range_max_m).contains(&range_m);
            (seen && !dropped).then_some(range_m)
        };
        (0..self.beams).map(beam).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Shape;
    use crate::sim::random::{Purpose, stream};

    fn room() -> World {
        World::new([Shape::rectangle(&Pose2::IDENTITY, 8.0, 6.0)])
    }

    #[test]
    fn a_scan_in_a_box_is_the_box() {
        let mount = Pose2::new(0.2, -0.1, 0.5);
        let lidar = SimLidar::all_round(360, 20.0, 1e-9, mount);
        let pose = Pose2::new(1.0, 0.5, -2.5);
        let ranges = lidar.scan(&room(), &pose, &mut stream(3, Purpose::Ranges));
        assert_eq!(ranges.len(), 360);
        for (k, range) in ranges.into_iter().enumerate() {
            let angle = lidar.geometry.beam_angle_rad(k);
            let in_lidar = Vector2::new(angle.cos(), angle.sin()) * range.unwrap();
            let end = pose.transform(&mount.transform(&in_lidar));
            // Signed distance from the room's line, negative inside.
            let beyond = (end.x.abs() - 4.0).max(end.y.abs() - 3.0);
            assert!(beyond.abs() < 1e-3, "beam {k} ends at {end:?}");
        }
    }

    #[test]
    fn noise_dropouts_and_reach() {
        let mut lidar = SimLidar::all_round(3600, 3.9, 0.02, Pose2::IDENTITY);
        lidar.dropout_rate = 0.25;
        let mut rng = stream(4, Purpose::Ranges);
        let ranges = lidar.scan(&room(), &Pose2::IDENTITY, &mut rng);
        let mut squared = Vec::new();
        let mut dropped = 0;
        let mut reachable = 0;
        for (k, range) in ranges.iter().enumerate() {
            let (sin, cos) = lidar.geometry.beam_angle_rad(k).sin_cos();
            let truth = (4.0 / cos.abs()).min(3.0 / sin.abs());
            assert!(range.is_none_or(|r| (0.05..3.9).contains(&r)));
            if truth < 3.8 {
                reachable += 1;
                match range {
                    Some(r) => squared.push((r - truth).powi(2)),
                    None => dropped += 1,
                }
            } else if truth > 4.1 {
                assert_eq!(*range, None);
            }
        }
        let share = f64::from(dropped) / f64::from(reachable);
        assert!((share - 0.25).abs() < 0.05, "{share}");
        let sigma = (squared.iter().sum::<f64>() / squared.len() as f64).sqrt();
        assert!((sigma - 0.02).abs() < 0.002, "{sigma}");
    }
}
