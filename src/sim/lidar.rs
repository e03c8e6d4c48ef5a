//! A lidar in a simulated world.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::pass_errors::{LapErrors, PassErrors};
use super::random::normal;
use crate::geometry::{Pose2, Vector2};
use crate::scan::Lidar;

/// Default height of the scan plane, metres above the floor: that of safety scanners.
pub(super) const PLANE_M: f64 = 0.2;

/// A lidar with its faults.
#[derive(Debug, Clone, PartialEq)]
pub struct SimLidar {
    /// Its geometry; `range_sigma_m` is the noise of every range.
    pub geometry: Lidar,
    /// Beams of a scan.
    pub beams: usize,
    /// Height of its scan plane above the floor, metres.
    pub height_m: f64,
    /// Share of the beams that lose their return.
    pub dropout_rate: f64,
    /// `mount_from_lidar`: where the lidar truly sits, seen from where `geometry` has it. The
    /// identity unless the vehicle is faulty.
    pub mount_error: Pose2,
    /// The errors that the scans of a lap have in common.
    pub pass_errors: PassErrors,
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
                band: None,
            },
            beams,
            height_m: PLANE_M,
            dropout_rate: 0.0,
            mount_error: Pose2::IDENTITY,
            pass_errors: PassErrors::NONE,
        }
    }

    /// Beams over a field of view that is centred ahead, the first and the last on its borders.
    pub fn sector(
        field_rad: f64,
        beams: usize,
        range_max_m: f64,
        range_sigma_m: f64,
        mount: Pose2,
    ) -> Self {
        let mut lidar = Self::all_round(beams, range_max_m, range_sigma_m, mount);
        lidar.geometry.angle_min_rad = -0.5 * field_rad;
        lidar.geometry.angle_increment_rad = field_rad / (beams.max(2) - 1) as f64;
        lidar
    }

    /// Two lidars of one make, at the front and at the rear of a vehicle 0.8 m long, that look
    /// ahead and back, at opposite corners.
    pub fn front_and_rear(
        field_rad: f64,
        beams: usize,
        range_max_m: f64,
        range_sigma_m: f64,
    ) -> [Self; 2] {
        let front = Pose2::new(0.4, 0.1, 0.0);
        let rear = Pose2::new(-0.4, -0.1, std::f64::consts::PI);
        [front, rear].map(|mount| Self::sector(field_rad, beams, range_max_m, range_sigma_m, mount))
    }

    /// One scan: metres to the millimetre and what was met there, `None` for no return. `cast`
    /// follows a ray from an origin in a direction, map frame; `errors` are the lap's.
    pub(super) fn scan<T: Copy + PartialEq>(
        &self,
        cast: impl Fn(&Vector2<f64>, &Vector2<f64>) -> Option<(f64, T)>,
        map_from_base: &Pose2,
        errors: &LapErrors,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Option<(f64, T)>> {
        let mount_error = self.mount_error.compose(&errors.mount);
        let base_from_lidar = self.geometry.mount.compose(&mount_error);
        let map_from_lidar = map_from_base.compose(&base_from_lidar);
        let eye = map_from_lidar.translation();
        let met = |k| {
            let (sin, cos) = (map_from_lidar.theta + self.geometry.beam_angle_rad(k)).sin_cos();
            cast(&eye, &Vector2::new(cos, sin))
        };
        let mut met: Vec<_> = (0..self.beams).map(met).collect();
        errors.disturb(&mut met, self.geometry.angle_increment_rad, rng);
        let measured = |met: Option<(f64, T)>| {
            // Drawn for every beam: a change of the world does not change the noise of other beams.
            let noise_m = normal(rng, self.geometry.range_sigma_m);
            let dropped = rng.random::<f64>() < self.dropout_rate;
            let (true_range_m, what) = met?;
            let range_m = ((true_range_m + noise_m) * 1e3).round() / 1e3;
            let seen = (self.geometry.range_min_m..self.geometry.range_max_m).contains(&range_m);
            (seen && !dropped).then_some((range_m, what))
        };
        met.into_iter().map(measured).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::random::{Purpose, stream};
    use crate::sim::{Shape, World};

    fn scan_in_room(lidar: &SimLidar, map_from_base: &Pose2, seed: u64) -> Vec<Option<f64>> {
        let room = World::new([Shape::rectangle(&Pose2::IDENTITY, 8.0, 6.0)]);
        let cast = |origin: &_, direction: &_| Some((room.cast(origin, direction)?.range_m, ()));
        let mut rng = stream(seed, Purpose::Ranges { from_lap: 0 });
        let errors = PassErrors::NONE.draw(seed, 0, seed, 0);
        let met = lidar.scan(cast, map_from_base, &errors, &mut rng);
        met.into_iter().map(|beam| Some(beam?.0)).collect()
    }

    #[test]
    fn a_scan_in_a_box_is_the_box() {
        let mount = Pose2::new(0.2, -0.1, 0.5);
        let lidar = SimLidar::all_round(360, 20.0, 1e-9, mount);
        let pose = Pose2::new(1.0, 0.5, -2.5);
        let ranges = scan_in_room(&lidar, &pose, 3);
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
    fn a_faulty_mount_turns_what_is_seen() {
        let mount = Pose2::new(0.2, -0.1, 0.5);
        let faulty = SimLidar {
            mount_error: Pose2::new(0.0, 0.0, 2.0_f64.to_radians()),
            ..SimLidar::all_round(360, 20.0, 1e-9, mount)
        };
        let turned = SimLidar::all_round(360, 20.0, 1e-9, mount.compose(&faulty.mount_error));
        let sound = SimLidar::all_round(360, 20.0, 1e-9, mount);
        let pose = Pose2::new(1.0, 0.5, -2.5);
        let seen = scan_in_room(&faulty, &pose, 3);
        assert_eq!(seen, scan_in_room(&turned, &pose, 3));
        assert_ne!(seen, scan_in_room(&sound, &pose, 3));
        assert_eq!(faulty.geometry.mount, mount);
    }

    #[test]
    fn noise_dropouts_and_reach() {
        let mut lidar = SimLidar::all_round(3600, 3.9, 0.02, Pose2::IDENTITY);
        lidar.dropout_rate = 0.25;
        let ranges = scan_in_room(&lidar, &Pose2::IDENTITY, 4);
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
