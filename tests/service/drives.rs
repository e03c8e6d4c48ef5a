//! Simulated drives as uploads.

use std::sync::LazyLock;

use jiff::{SignedDuration, Timestamp};
use mapshift::geometry::{Pose2, Vector2};
use mapshift::sim::{Hall, OdometryError, Route, Shape, SimLidar, SimScan, Vehicle, World, drive};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

/// The hall that most vehicles drive in.
pub static HALL: LazyLock<Hall> = LazyLock::new(|| Hall::generate(1).unwrap());

/// A workshop that has nothing in common with the hall.
pub fn workshop() -> Hall {
    let rectangle =
        |x, y, theta, length, width| Shape::rectangle(&Pose2::new(x, y, theta), length, width);
    let round = |x, y, radius_m| Shape::Round {
        centre: Vector2::new(x, y),
        radius_m,
    };
    let world = World::new([
        rectangle(6.0, 5.0, 0.0, 13.0, 11.0),
        rectangle(4.5, 4.6, 0.6, 2.0, 1.5),
        rectangle(6.5, 9.9, 0.0, 5.0, 1.0),
        rectangle(12.0, 6.5, 0.0, 0.8, 3.0),
        rectangle(8.2, 5.8, 0.2, 0.6, 2.2),
        round(0.3, 8.8, 0.6),
    ]);
    let corners = [(2.0, 2.0), (10.0, 2.0), (10.0, 8.0), (2.0, 8.0)];
    let corners = corners.map(|(x, y)| Vector2::new(x, y));
    let route = Route::new(&corners, 1.0).unwrap();
    Hall { world, route }
}

/// An upload.
#[derive(Debug, Clone)]
pub struct Batch {
    pub id: String,
    pub body: Vec<u8>,
}

/// A drive, ready to be cut into batches.
#[derive(Debug, Clone)]
pub struct Drive {
    pub vehicle: String,
    pub trip: String,
    /// When the drive began.
    pub began: Timestamp,
    pub initial_pose: Option<Pose2>,
    pub lidar: Value,
    pub scans: Vec<SimScan>,
}

/// The first vehicle: 180 beams, 20 m.
pub fn first_vehicle() -> Vehicle {
    Vehicle {
        lidar: SimLidar {
            dropout_rate: 0.01,
            ..SimLidar::all_round(180, 20.0, 0.01, Pose2::new(0.2, 0.0, 0.0))
        },
        odometry: OdometryError {
            scale: 0.01,
            yaw_drift_rad_per_m: 5e-4,
            sigma_xy_m: 0.005,
            sigma_theta_rad: 0.003,
        },
        path_noise_m: 0.3,
        scan_spacing_m: 0.5,
        speed_mps: 1.2,
    }
}

/// Another build: its lidar sits elsewhere and its wheels err differently.
pub fn second_vehicle() -> Vehicle {
    let first = first_vehicle();
    Vehicle {
        lidar: SimLidar {
            dropout_rate: 0.01,
            ..SimLidar::all_round(180, 20.0, 0.01, Pose2::new(-0.1, 0.05, 0.3))
        },
        odometry: OdometryError {
            scale: -0.008,
            yaw_drift_rad_per_m: -4e-4,
            ..first.odometry
        },
        ..first
    }
}

impl Drive {
    /// The first `length` scans of a vehicle's laps through a hall; it knows where it starts.
    pub fn through(
        hall: &Hall,
        vehicle: &Vehicle,
        names: (&str, &str),
        length: usize,
        seed: u64,
    ) -> Self {
        let per_lap = (hall.route.length_m() / vehicle.scan_spacing_m).floor() as usize;
        let laps = length.div_ceil(per_lap);
        let mut scans = drive(&hall.world, &hall.route, vehicle, laps, seed);
        scans.truncate(length);
        Self::of(vehicle, names, scans, seed as i64)
    }

    /// Scans that a vehicle recorded, this many hours after the first of all drives; it knows where
    /// it starts.
    pub fn of(
        vehicle: &Vehicle,
        (name, trip): (&str, &str),
        scans: Vec<SimScan>,
        hours: i64,
    ) -> Self {
        let began: Timestamp = "2026-11-20T06:00:00Z".parse().unwrap();
        let geometry = &vehicle.lidar.geometry;
        let mount = &geometry.mount;
        Self {
            vehicle: name.to_owned(),
            trip: trip.to_owned(),
            began: began + SignedDuration::from_hours(hours),
            initial_pose: scans.first().map(|scan| scan.map_from_base),
            lidar: json!({
                "angle_min": geometry.angle_min_rad,
                "angle_increment": geometry.angle_increment_rad,
                "range_min": geometry.range_min_m,
                "range_max": geometry.range_max_m,
                "mount": {"x": mount.x, "y": mount.y, "theta": mount.theta},
                "range_sigma": geometry.range_sigma_m,
                "band": geometry.band.map(|view| json!({
                    "from": view.band.from_m, "to": view.band.to_m,
                    "clear_from": view.clear_from_m, "clear_to": view.clear_to_m,
                })),
            }),
            scans,
        }
    }

    /// The same drive of a vehicle that does not know where it starts.
    pub fn without_pose(mut self) -> Self {
        self.initial_pose = None;
        self
    }

    pub fn stamp(&self, scan: &SimScan) -> Timestamp {
        self.began + SignedDuration::from_millis((scan.time_s * 1e3).round() as i64)
    }

    /// The drive's batches in order, `scans` scans each.
    pub fn batches(&self, scans: usize) -> Vec<Batch> {
        let chunks = self.scans.chunks(scans).enumerate();
        chunks.map(|(k, scans)| self.batch(k, scans)).collect()
    }

    fn batch(&self, sequence: usize, scans: &[SimScan]) -> Batch {
        let pose = |p: &Pose2| json!({"x": p.x, "y": p.y, "theta": p.theta});
        let scans: Vec<Value> = scans
            .iter()
            .map(|scan| {
                json!({
                    "stamp": self.stamp(scan),
                    "odometry": pose(&scan.odom_from_base),
                    "ranges": scan.ranges_m,
                })
            })
            .collect();
        let mut body = json!({
            "vehicle_id": self.vehicle, "trip_id": self.trip, "sequence": sequence,
            "lidar": self.lidar, "scans": scans,
        });
        if let Some(at) = self.initial_pose.filter(|_| sequence == 0) {
            body["initial_pose"] = json!({
                "x": at.x, "y": at.y, "theta": at.theta, "sigma_xy": 0.1, "sigma_theta": 0.03,
            });
        }
        Batch {
            id: format!("{}-{sequence:03}", self.trip),
            body: serde_json::to_vec(&body).unwrap(),
        }
    }
}

impl Batch {
    /// The same upload under another id.
    pub fn named(&self, id: &str) -> Self {
        Self {
            id: id.to_owned(),
            body: self.body.clone(),
        }
    }

    /// The same upload with some fields replaced, under another id.
    pub fn with(&self, id: &str, fields: Value) -> Self {
        let mut body: Value = serde_json::from_slice(&self.body).unwrap();
        for (field, value) in fields.as_object().unwrap() {
            body[field] = value.clone();
        }
        Self {
            id: id.to_owned(),
            body: serde_json::to_vec(&body).unwrap(),
        }
    }
}

/// Two vehicles that drive the same `length` scans of the hall.
pub fn two_vehicles(length: usize) -> [Drive; 2] {
    let first = Drive::through(&HALL, &first_vehicle(), ("agv-01", "one"), length, 1);
    let second = Drive::through(&HALL, &second_vehicle(), ("agv-02", "two"), length, 2);
    [first, second]
}

/// One of each in turn.
pub fn interleaved(drives: &[Vec<Batch>]) -> Vec<Batch> {
    let longest = drives.iter().map(Vec::len).max().unwrap_or(0);
    let turns = (0..longest).flat_map(|k| drives.iter().filter_map(move |d| d.get(k)));
    turns.cloned().collect()
}

/// In an order that the seed decides.
pub fn shuffled(mut batches: Vec<Batch>, seed: u64) -> Vec<Batch> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for k in (1..batches.len()).rev() {
        batches.swap(k, rng.random_range(0..=k));
    }
    batches
}
