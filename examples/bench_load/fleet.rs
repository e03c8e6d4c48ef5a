//! What the vehicles send.

use std::io::Write;

use anyhow::Context;
use flate2::Compression;
use flate2::write::GzEncoder;
use jiff::{SignedDuration, Timestamp};
use mapshift::geometry::Pose2;
use mapshift::sim::{Hall, OdometryError, SimLidar, SimScan, Vehicle, drive};
use serde_json::{Value, json};

const SCANS_PER_BATCH: usize = 20;
/// Seeds of the halls that the routes go through.
const HALLS: u64 = 4;

/// Who drives where, and how often.
pub struct Fleet {
    pub vehicles: usize,
    pub routes: usize,
    /// Of each vehicle: one lap each.
    pub trips: usize,
    pub beams: usize,
}

/// An upload.
pub struct Batch {
    pub id: String,
    pub gzip: Vec<u8>,
}

/// Everything that one vehicle sends, in order.
pub struct Uploads {
    pub route: String,
    pub batches: Vec<Batch>,
    pub scans: usize,
}

/// A vehicle with a lidar of 20 m and 1 cm.
pub fn vehicle(beams: usize) -> Vehicle {
    Vehicle {
        lidar: SimLidar {
            dropout_rate: 0.01,
            ..SimLidar::all_round(beams, 20.0, 0.01, Pose2::new(0.2, 0.0, 0.0))
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

impl Fleet {
    /// Simulates all drives; vehicle k drives on route k modulo their number.
    pub fn uploads(&self) -> anyhow::Result<Vec<Uploads>> {
        let halls: Vec<Hall> = (1..=HALLS.min(self.routes as u64))
            .map(|seed| Hall::generate(seed).context("no hall"))
            .collect::<Result<_, _>>()?;
        (0..self.vehicles)
            .map(|vehicle| self.uploads_of(vehicle, &halls))
            .collect()
    }

    fn uploads_of(&self, k: usize, halls: &[Hall]) -> anyhow::Result<Uploads> {
        let route = k % self.routes;
        let hall = &halls[route % halls.len()];
        let vehicle = vehicle(self.beams);
        let mut uploads = Uploads {
            route: format!("route-{route}"),
            batches: Vec::new(),
            scans: 0,
        };
        for trip in 0..self.trips {
            let seed = (k * self.trips + trip) as u64;
            let scans = drive(&hall.world, &hall.route, &vehicle, 1, seed);
            uploads.scans += scans.len();
            for (sequence, part) in scans.chunks(SCANS_PER_BATCH).enumerate() {
                let name = format!("trip-{k}-{trip}");
                let body = body(&vehicle, k, &name, sequence, part)?;
                let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
                encoder.write_all(&body)?;
                uploads.batches.push(Batch {
                    id: format!("{name}-{sequence}"),
                    gzip: encoder.finish()?,
                });
            }
        }
        Ok(uploads)
    }
}

/// The body of an upload.
pub fn body(
    vehicle: &Vehicle,
    number: usize,
    trip: &str,
    sequence: usize,
    scans: &[SimScan],
) -> anyhow::Result<Vec<u8>> {
    let pose = |p: &Pose2| json!({"x": p.x, "y": p.y, "theta": p.theta});
    let geometry = &vehicle.lidar.geometry;
    let began = Timestamp::now() - SignedDuration::from_hours(1);
    let stamped = scans.iter().map(|scan| {
        let after = SignedDuration::from_millis((scan.time_s * 1e3) as i64);
        json!({
            "stamp": began + after,
            "odometry": pose(&scan.odom_from_base),
            "ranges": scan.ranges_m,
        })
    });
    let mut body = json!({
        "vehicle_id": format!("agv-{number}"), "trip_id": trip, "sequence": sequence,
        "lidar": {
            "angle_min": geometry.angle_min_rad, "angle_increment": geometry.angle_increment_rad,
            "range_min": geometry.range_min_m, "range_max": geometry.range_max_m,
            "mount": pose(&geometry.mount), "range_sigma": geometry.range_sigma_m,
        },
        "scans": stamped.collect::<Vec<Value>>(),
    });
    if let Some(first) = scans.first().filter(|_| sequence == 0) {
        body["initial_pose"] = pose(&first.map_from_base);
        body["initial_pose"]["sigma_xy"] = json!(0.1);
        body["initial_pose"]["sigma_theta"] = json!(0.03);
    }
    Ok(serde_json::to_vec(&body)?)
}
