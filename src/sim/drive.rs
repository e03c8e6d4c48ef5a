//! Simulated trips: laps as a vehicle records them.

use std::ops::Range;

use rand_chacha::ChaCha8Rng;

use super::pass_errors::LapErrors;
use super::random::{Purpose, stream};
use super::walker::Walkers;
use super::{LapWorld, Route, Scene, SimCloudLidar, SimLidar, Vehicle, World};
use crate::geometry::Pose2;
use crate::scan::{BandScanner, ScanError};

/// A scan with the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SimScan {
    /// Seconds since the trip began.
    pub time_s: f64,
    /// The scene's lap, 0 for its first.
    pub lap: usize,
    /// True pose: `map_from_base`.
    pub map_from_base: Pose2,
    /// Pose by odometry, which starts at the identity.
    pub odom_from_base: Pose2,
    /// Metres, `None` for no return; 0 for an invalid beam of a virtual scan.
    pub ranges_m: Vec<Option<f64>>,
    /// The object that each beam hit, by its index in [`Scene::objects`]; `None` for no return or a person.
    pub hit_objects: Vec<Option<usize>>,
}

/// Drives `laps` laps without a break in a world that stays as it is.
///
/// The path of a lap depends on the seed and the lap's number alone; another object in the world does not
/// change path, odometry or the noise of other beams.
pub fn drive(
    world: &World,
    route: &Route,
    vehicle: &Vehicle,
    laps: usize,
    seed: u64,
) -> Vec<SimScan> {
    let scene = Scene::lasting(route.clone(), world.shapes().cloned(), 0);
    scene.drive(vehicle, 0..laps, seed)
}

impl Scene {
    /// Drives laps of the scene without a break: one odometry frame, one clock.
    ///
    /// The path of a lap depends on the seed and the lap's number alone, and lap 0 keeps to the
    /// route; a change of the scene does not change path, odometry or the noise of other beams.
    pub fn drive(&self, vehicle: &Vehicle, laps: Range<usize>, seed: u64) -> Vec<SimScan> {
        let from_lap = laps.start;
        let ranges = stream(seed, Purpose::Ranges { from_lap });
        self.drive_with(vehicle, &vehicle.lidar, laps, seed, ranges)
    }

    /// The scans of another lidar of the vehicle on the same trip, at the same moments. `number` gives each
    /// such lidar its own noise.
    pub fn drive_of_companion(
        &self,
        vehicle: &Vehicle,
        (number, companion): (usize, &SimLidar),
        laps: Range<usize>,
        seed: u64,
    ) -> Vec<SimScan> {
        let (from_lap, lidar) = (laps.start, number);
        let ranges = stream(seed, Purpose::CompanionRanges { from_lap, lidar });
        self.drive_with(vehicle, companion, laps, seed, ranges)
    }

    fn drive_with(
        &self,
        vehicle: &Vehicle,
        lidar: &SimLidar,
        laps: Range<usize>,
        seed: u64,
        mut ranges: ChaCha8Rng,
    ) -> Vec<SimScan> {
        let shared = &lidar.pass_errors;
        let mut here: Option<(LapWorld, LapErrors)> = None;
        let mut scans: Vec<SimScan> = Vec::new();
        self.travel(vehicle, laps, seed, |at, people| {
            if scans.last().is_none_or(|last| last.lap != at.lap) {
                here = None;
            }
            let (world, errors) = here.get_or_insert_with(|| {
                let errors = shared.draw(seed, at.lap, self.seed, self.objects.len());
                (self.world_at(at.lap, lidar.height_m), errors)
            });
            let base_from_map = Pose2::new(0.0, 0.0, -at.map_from_base.theta);
            let cast = |origin: &_, direction: &_| {
                let (range_m, object) = world.cast(people, origin, direction)?;
                let direction = base_from_map.transform(direction);
                Some((
                    range_m + errors.longer_m(range_m, &direction, object),
                    object,
                ))
            };
            let beams = lidar.scan(cast, &at.map_from_base, errors, &mut ranges);
            scans.push(SimScan {
                ranges_m: beams.iter().map(|beam| Some(beam.as_ref()?.0)).collect(),
                hit_objects: beams.iter().map(|beam| beam.as_ref()?.1).collect(),
                ..at
            });
        });
        scans
    }

    /// As [`Scene::drive`], with a 3D lidar from whose clouds a gateway makes virtual scans: the trip of each
    /// scanner. The objects that beams hit are not known.
    ///
    /// # Errors
    /// [`ScanError`] if a scanner's beams do not fit its lidar, which does not happen.
    pub fn drive_bands(
        &self,
        vehicle: &Vehicle,
        lidar: &SimCloudLidar,
        scanners: &[BandScanner],
        laps: Range<usize>,
        seed: u64,
    ) -> Result<Vec<Vec<SimScan>>, ScanError> {
        let mut ranges = stream(
            seed,
            Purpose::Ranges {
                from_lap: laps.start,
            },
        );
        let mut drives = vec![Vec::new(); scanners.len()];
        let mut refused = None;
        self.travel(vehicle, laps, seed, |at, people| {
            let cloud = lidar.cloud(self, at.lap, people, &at.map_from_base, &mut ranges);
            for (scanner, drive) in scanners.iter().zip(&mut drives) {
                match scanner.scan(cloud.iter().copied()) {
                    Ok(scan) => drive.push(SimScan {
                        ranges_m: scan.uploaded_ranges_m().collect(),
                        ..at.clone()
                    }),
                    Err(error) => refused = Some(error),
                }
            }
        });
        refused.map_or(Ok(drives), Err)
    }

    /// Drives along the route and calls `take_scan` at each scan, with a scan without ranges and the people
    /// around.
    fn travel(
        &self,
        vehicle: &Vehicle,
        laps: Range<usize>,
        seed: u64,
        mut take_scan: impl FnMut(SimScan, &World),
    ) {
        let from_lap = laps.start;
        let mut odometry = stream(seed, Purpose::Odometry { from_lap });
        let mut last: Option<SimScan> = None;
        for lap in laps {
            let here = self.world_at(lap, vehicle.lidar.height_m);
            let mut walkers = Walkers::new(self, &here.world, lap, seed);
            let path_noise_m = if lap == 0 { 0.0 } else { vehicle.path_noise_m };
            let mut path = stream(seed, Purpose::Path { lap });
            let spacing_m = vehicle.scan_spacing_m;
            for map_from_base in self.route.lap(spacing_m, path_noise_m, &mut path) {
                let (time_s, odom_from_base) = match &last {
                    None => (0.0, Pose2::IDENTITY),
                    Some(last) => {
                        let motion = last.map_from_base.between(&map_from_base);
                        let measured = vehicle.odometry.measured(&motion, &mut odometry);
                        let took_s = motion.translation().norm() / vehicle.speed_mps;
                        walkers.walk(took_s);
                        (last.time_s + took_s, last.odom_from_base.compose(&measured))
                    }
                };
                let people = walkers.seen_from(&map_from_base.translation());
                let at = SimScan {
                    time_s,
                    lap,
                    map_from_base,
                    odom_from_base,
                    ranges_m: Vec::new(),
                    hit_objects: Vec::new(),
                };
                take_scan(at.clone(), &people);
                last = Some(at);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Hall, OdometryError, Shape, SimLidar};

    fn vehicle() -> Vehicle {
        Vehicle {
            lidar: SimLidar::all_round(90, 20.0, 0.01, Pose2::new(0.2, 0.0, 0.0)),
            odometry: OdometryError {
                scale: 0.01,
                yaw_drift_rad_per_m: 0.001,
                sigma_xy_m: 0.005,
                sigma_theta_rad: 0.002,
            },
            path_noise_m: 0.5,
            scan_spacing_m: 0.5,
            speed_mps: 1.0,
        }
    }

    #[test]
    fn the_same_seed_is_the_same_drive() {
        let hall = Hall::generate(11).unwrap();
        let once = drive(&hall.world, &hall.route, &vehicle(), 2, 1);
        assert_eq!(once, drive(&hall.world, &hall.route, &vehicle(), 2, 1));
        assert_ne!(once, drive(&hall.world, &hall.route, &vehicle(), 2, 2));
        let per_lap = (hall.route.length_m() / 0.5).floor() as usize;
        assert_eq!(once.len(), 2 * per_lap);
        assert_eq!(once.iter().filter(|s| s.lap == 1).count(), per_lap);
        assert!(once.windows(2).all(|w| w[1].time_s > w[0].time_s));
    }

    #[test]
    fn another_lidar_is_on_the_same_drive_with_noise_of_its_own() {
        let hall = Hall::generate(11).unwrap();
        let scene = Scene::of_hall(&hall, 0);
        let vehicle = vehicle();
        let alone = scene.drive(&vehicle, 0..1, 1);
        let rear = |number| scene.drive_of_companion(&vehicle, (number, &vehicle.lidar), 0..1, 1);
        let (first, second) = (rear(1), rear(2));
        assert_eq!(alone.len(), first.len());
        for (a, b) in alone.iter().zip(&first) {
            assert_eq!(a.time_s, b.time_s);
            assert_eq!(
                (a.map_from_base, a.odom_from_base),
                (b.map_from_base, b.odom_from_base)
            );
            assert_ne!(a.ranges_m, b.ranges_m);
        }
        assert_ne!(first[0].ranges_m, second[0].ranges_m);
    }

    #[test]
    fn a_change_of_the_world_changes_only_what_is_seen_of_it() {
        let hall = Hall::generate(12).unwrap();
        let at = hall.route.pose_at(10.0).compose(&Pose2::new(0.0, 1.2, 0.0));
        let crate_ = Shape::rectangle(&at, 0.5, 0.5);
        let changed = World::new(hall.world.shapes().cloned().chain([crate_]));
        let before = drive(&hall.world, &hall.route, &vehicle(), 1, 3);
        let after = drive(&changed, &hall.route, &vehicle(), 1, 3);
        let mut differing = 0;
        for (a, b) in before.iter().zip(&after) {
            assert_eq!(a.odom_from_base, b.odom_from_base);
            assert_eq!(a.map_from_base, b.map_from_base);
            let nearer = |x: &Option<f64>, y: &Option<f64>| y.is_some() && (x.is_none() || y < x);
            let pairs = a.ranges_m.iter().zip(&b.ranges_m);
            let changed: Vec<_> = pairs.filter(|(x, y)| x != y).collect();
            assert!(changed.iter().all(|(x, y)| nearer(x, y)), "{changed:?}");
            differing += changed.len();
        }
        assert!(differing > 50, "{differing}");
    }

    #[test]
    fn odometry_drifts_as_stated() {
        let hall = Hall::generate(13).unwrap();
        let mut vehicle = vehicle();
        vehicle.odometry = OdometryError {
            scale: 0.02,
            yaw_drift_rad_per_m: 0.0,
            sigma_xy_m: 0.0,
            sigma_theta_rad: 0.0,
        };
        let scans = drive(&hall.world, &hall.route, &vehicle, 1, 4);
        for pair in scans.windows(2) {
            let truth = pair[0].map_from_base.between(&pair[1].map_from_base);
            let reported = pair[0].odom_from_base.between(&pair[1].odom_from_base);
            let way = |p: &Pose2| p.translation().norm();
            assert!((way(&reported) / way(&truth) - 1.02).abs() < 1e-9);
            assert!((reported.theta - truth.theta).abs() < 1e-9);
        }
    }
}
