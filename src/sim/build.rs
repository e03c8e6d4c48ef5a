//! The vehicles of a mixed fleet.

use super::{OdometryError, SimLidar, Vehicle};
use crate::geometry::Pose2;

const SCAN_SPACING_M: f64 = 0.25;
const SPEED_MPS: f64 = 1.2;
const DROPOUT_RATE: f64 = 0.01;

impl Vehicle {
    /// The vehicle of a number, whose laps stray by `path_noise_m`. Four builds take turns: two
    /// look all round over 20 m from different mounts, the third looks 270° over 30 m, the fourth
    /// 240° over 10 m with a noise of 2 cm instead of 1 cm. Their wheels err differently.
    pub fn of_fleet(number: usize, path_noise_m: f64) -> Self {
        let right_angles = |count: f64| count * std::f64::consts::FRAC_PI_2;
        let (lidar, scale, yaw_drift_rad_per_m) = match number % 4 {
            0 => {
                let mount = Pose2::new(0.2, 0.0, 0.0);
                (SimLidar::all_round(360, 20.0, 0.01, mount), 0.01, 5e-4)
            }
            1 => {
                let mount = Pose2::new(-0.1, 0.05, 0.3);
                (SimLidar::all_round(360, 20.0, 0.01, mount), -0.008, -4e-4)
            }
            2 => {
                let mount = Pose2::new(0.35, 0.0, 0.0);
                let lidar = SimLidar::sector(right_angles(3.0), 541, 30.0, 0.01, mount);
                (lidar, 0.005, -5e-4)
            }
            _ => {
                let mount = Pose2::new(0.25, -0.1, 0.05);
                let lidar = SimLidar::sector(right_angles(8.0 / 3.0), 481, 10.0, 0.02, mount);
                (lidar, -0.012, 3e-4)
            }
        };
        Self {
            lidar: SimLidar {
                dropout_rate: DROPOUT_RATE,
                ..lidar
            },
            odometry: OdometryError {
                scale,
                yaw_drift_rad_per_m,
                sigma_xy_m: 0.005,
                sigma_theta_rad: 0.003,
            },
            path_noise_m,
            scan_spacing_m: SCAN_SPACING_M,
            speed_mps: SPEED_MPS,
        }
    }

    /// The same vehicle with its lidar turned on its mount, without stating so.
    pub fn with_turned_lidar(mut self, turn_rad: f64) -> Self {
        self.lidar.mount_error = Pose2::new(0.0, 0.0, turn_rad);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Scene;

    #[test]
    fn every_build_sees_its_field_and_reach() {
        let scene = Scene::street(1).unwrap();
        let seen = [(360.0, 20.0), (360.0, 20.0), (270.0, 30.0), (240.0, 10.0)];
        for (number, (field_deg, reach_m)) in seen.into_iter().enumerate() {
            let vehicle = Vehicle::of_fleet(number, 0.5);
            let lidar = &vehicle.lidar;
            let beams = (lidar.beams - usize::from(number > 1)) as f64;
            let field = (lidar.geometry.angle_increment_rad * beams).to_degrees();
            assert!((field - field_deg).abs() < 1e-9, "{field}");
            let scans = scene.drive(&vehicle, 0..1, 1);
            assert!(scans.iter().all(|s| s.ranges_m.len() == lidar.beams));
            let ranges = scans.iter().flat_map(|s| s.ranges_m.iter().flatten());
            let farthest = ranges.copied().fold(0.0, f64::max);
            assert!(farthest < reach_m && farthest > 0.9 * reach_m, "{farthest}");
            lidar.geometry.clone().validated().unwrap();
        }
    }

    #[test]
    fn a_turned_lidar_turns_what_is_seen_and_nothing_else() {
        let scene = Scene::street(2).unwrap();
        let sound = Vehicle::of_fleet(0, 0.5);
        let turn_rad = 2.0 * sound.lidar.geometry.angle_increment_rad;
        let faulty = sound.clone().with_turned_lidar(turn_rad);
        assert_eq!(faulty.lidar.geometry, sound.lidar.geometry);
        let (seen, turned) = (scene.drive(&sound, 0..1, 3), scene.drive(&faulty, 0..1, 3));
        for (seen, turned) in seen.iter().zip(&turned) {
            assert_eq!(seen.odom_from_base, turned.odom_from_base);
            // Two beams on: what is met moves on by two, whatever the noise.
            let same = (0..358).filter(|&k| seen.hit_objects[k + 2] == turned.hit_objects[k]);
            let unmoved = (0..358).filter(|&k| seen.hit_objects[k] == turned.hit_objects[k]);
            assert!(same.count() >= 320);
            assert!(unmoved.count() < 358);
        }
    }
}
