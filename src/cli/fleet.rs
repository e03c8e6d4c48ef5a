//! Simulated vehicles that drive laps and upload what they see.

use std::time::Duration;

use anyhow::Context;
use jiff::Timestamp;
use tokio::time::{Instant, sleep, sleep_until};

use super::batch_body::{EncodedBatch, ScanToSend, Trip};
use super::gateway::{BatchReport, Gateway};
use super::progress::{Progress, say};
use crate::geometry::Pose2;
use crate::ids::{BatchId, RouteId, StampNs, TripId, VehicleId};
use crate::sim::{Hall, OdometryError, SimLidar, SimScan, Vehicle, drive};

const SCANS_PER_BATCH: usize = 30;
/// How often a batch's state is asked for, and how long at most before the drive goes on.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
const POLL_MAX: Duration = Duration::from_secs(5);
/// How long to wait at the end for what is still under way.
const SETTLE_MAX: Duration = Duration::from_secs(120);

/// Vehicles with the drives they have before them.
pub(super) struct Fleet {
    drives: Vec<Drive>,
    laps: usize,
}

struct Drive {
    trip: Trip,
    batches: Vec<LapBatch>,
}

struct LapBatch {
    lap: usize,
    scans: usize,
    encoded: EncodedBatch,
}

/// What became of a fleet's batches.
pub(super) struct Settled {
    /// Batches sent.
    pub batches: usize,
    /// Scans sent.
    pub scans: usize,
    /// Batches that are not in the map, with the service's words.
    pub left_out: Vec<String>,
}

impl Fleet {
    /// Two vehicles that drive `laps` laps each through a hall. The first is told where it
    /// starts, the second is not. Its drives end shortly before `now`.
    pub(super) fn new(hall: &Hall, laps: usize, seed: u64, now: Timestamp) -> anyhow::Result<Self> {
        let name = now.strftime("%Y%m%dT%H%M%S");
        let vehicles = [first_vehicle(), second_vehicle()];
        let mut drives = Vec::new();
        for (k, vehicle) in vehicles.iter().enumerate() {
            let scans = drive(&hall.world, &hall.route, vehicle, laps, seed + k as u64);
            let vehicle_id = VehicleId::new(format!("agv-{:02}", k + 1))?;
            let trip = Trip {
                trip_id: TripId::new(format!("{vehicle_id}-{name}"))?,
                vehicle_id,
                lidar: vehicle.lidar.geometry.clone(),
                initial_pose: scans.first().filter(|_| k == 0).map(|s| s.map_from_base),
            };
            drives.push(Drive::new(trip, &scans, now)?);
        }
        Ok(Self { drives, laps })
    }

    /// Batches in all drives.
    pub(super) fn batch_count(&self) -> usize {
        self.drives.iter().map(|d| d.batches.len()).sum()
    }

    /// Drives lap after lap, one vehicle after the other, a batch every `pace`, and tells what
    /// the service makes of it.
    pub(super) async fn drive(
        &self,
        gateway: &Gateway,
        route: &RouteId,
        pace: Duration,
    ) -> anyhow::Result<()> {
        let mut progress = Progress::new(self.batch_count() as u64, "batches");
        let gateway = gateway.notifying(progress.speaker());
        for lap in 0..self.laps {
            for drive in &self.drives {
                let vehicle = &drive.trip.vehicle_id;
                progress.say(&format!("{vehicle}, lap {} of {}", lap + 1, self.laps));
                for batch in drive.batches.iter().filter(|b| b.lap == lap) {
                    let next = Instant::now() + pace;
                    gateway.put_batch(route, &batch.encoded).await?;
                    let report = report_of(&gateway, route, &batch.encoded.id).await?;
                    progress.say(&describe(batch, &report));
                    progress.advance(1);
                    sleep_until(next).await;
                }
            }
        }
        progress.finish();
        Ok(())
    }

    /// Waits until nothing is under way any more.
    pub(super) async fn settle(
        &self,
        gateway: &Gateway,
        route: &RouteId,
    ) -> anyhow::Result<Settled> {
        let give_up = Instant::now() + SETTLE_MAX;
        while gateway.route(route).await?.pending_batches > 0 {
            if Instant::now() > give_up {
                say("some batches are still under way");
                break;
            }
            sleep(4 * POLL_INTERVAL).await;
        }
        let mut settled = Settled {
            batches: self.batch_count(),
            scans: 0,
            left_out: Vec::new(),
        };
        for batch in self.drives.iter().flat_map(|d| &d.batches) {
            settled.scans += batch.scans;
            let report = gateway.batch(route, &batch.encoded.id).await?;
            if report.status != "merged" {
                let reason = report.reason.unwrap_or_default();
                let id = &batch.encoded.id;
                settled
                    .left_out
                    .push(format!("{id} is {}: {reason}", report.status));
            }
        }
        Ok(settled)
    }
}

impl Drive {
    fn new(trip: Trip, scans: &[SimScan], now: Timestamp) -> anyhow::Result<Self> {
        let last_s = scans.last().map_or(0.0, |s| s.time_s);
        let end_ms = now.as_millisecond();
        let stamp = |scan: &SimScan| {
            let before_end_ms = ((last_s - scan.time_s) * 1e3).round() as i64;
            StampNs((end_ms - before_end_ms) * 1_000_000)
        };
        let mut batches = Vec::new();
        for lap in scans.chunk_by(|a, b| a.lap == b.lap) {
            for chunk in lap.chunks(SCANS_PER_BATCH) {
                let to_send = chunk.iter().map(|scan| ScanToSend {
                    stamp: stamp(scan),
                    odom_from_base: scan.odom_from_base,
                    ranges_m: &scan.ranges_m,
                });
                batches.push(LapBatch {
                    lap: lap[0].lap,
                    scans: chunk.len(),
                    encoded: trip.encode(batches.len(), to_send)?,
                });
            }
        }
        Ok(Self { trip, batches })
    }
}

async fn report_of(
    gateway: &Gateway,
    route: &RouteId,
    batch: &BatchId,
) -> anyhow::Result<BatchReport> {
    let give_up = Instant::now() + POLL_MAX;
    loop {
        let report = gateway
            .batch(route, batch)
            .await
            .context("the service lost a batch that it had taken")?;
        if !report.is_under_way() || Instant::now() > give_up {
            return Ok(report);
        }
        sleep(POLL_INTERVAL).await;
    }
}

fn describe(batch: &LapBatch, report: &BatchReport) -> String {
    let LapBatch { scans, encoded, .. } = batch;
    let became = match (report.status.as_str(), &report.reason) {
        ("merged", _) => format!(
            "merged, {} nodes and {} loop closures more",
            report.nodes_added, report.loop_closures
        ),
        (status, Some(reason)) => format!("{status}: {reason}"),
        (status, None) => status.to_owned(),
    };
    format!("  {} ({scans} scans) {became}", encoded.id)
}

fn first_vehicle() -> Vehicle {
    Vehicle {
        lidar: SimLidar {
            dropout_rate: 0.01,
            ..SimLidar::all_round(360, 20.0, 0.01, Pose2::new(0.2, 0.0, 0.0))
        },
        odometry: OdometryError {
            scale: 0.01,
            yaw_drift_rad_per_m: 5e-4,
            sigma_xy_m: 0.005,
            sigma_theta_rad: 0.003,
        },
        path_noise_m: 0.3,
        scan_spacing_m: 0.25,
        speed_mps: 1.2,
    }
}

/// Another build of the same type: its lidar sits elsewhere and its wheels err differently.
fn second_vehicle() -> Vehicle {
    let first = first_vehicle();
    Vehicle {
        lidar: SimLidar {
            dropout_rate: 0.01,
            ..SimLidar::all_round(360, 20.0, 0.01, Pose2::new(-0.1, 0.05, 0.3))
        },
        odometry: OdometryError {
            scale: -0.008,
            yaw_drift_rad_per_m: -4e-4,
            ..first.odometry
        },
        ..first
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::pretend::{Faults, Pretend};

    #[test]
    fn a_fleet_is_ready_to_be_sent() {
        let hall = Hall::generate(1).unwrap();
        let now: Timestamp = "2026-11-21T06:00:00Z".parse().unwrap();
        let fleet = Fleet::new(&hall, 2, 1, now).unwrap();
        let per_lap = (hall.route.length_m() / 0.25).floor() as usize;
        assert_eq!(fleet.batch_count(), 4 * per_lap.div_ceil(SCANS_PER_BATCH));
        let again = Fleet::new(&hall, 2, 1, now).unwrap();
        for (a, b) in fleet.drives.iter().zip(&again.drives) {
            assert!(a.batches.iter().zip(&b.batches).all(|(a, b)| {
                a.encoded.id == b.encoded.id && a.encoded.gzip == b.encoded.gzip
            }));
        }
        let first = &fleet.drives[0];
        assert_eq!(
            first.batches[0].encoded.id.as_str(),
            "agv-01-20261121T060000-00000"
        );
        assert_eq!(first.trip.initial_pose, Some(hall.route.pose_at(0.0)));
        assert_eq!(fleet.drives[1].trip.initial_pose, None);
    }

    #[tokio::test]
    async fn a_fleet_drives_and_tells_what_was_left_out() {
        let service = Pretend::start(Faults {
            unanchored: Some("agv-02"),
            ..Faults::default()
        })
        .await;
        let hall = Hall::generate(1).unwrap();
        let now: Timestamp = "2026-11-21T06:00:00Z".parse().unwrap();
        let fleet = Fleet::new(&hall, 1, 1, now).unwrap();
        let gateway = Gateway::new(&service.url, say).unwrap();
        let route = RouteId::new("demo-hall").unwrap();
        assert!(gateway.ensure_route(&route, Some("Hall")).await.unwrap());
        fleet.drive(&gateway, &route, Duration::ZERO).await.unwrap();
        let settled = fleet.settle(&gateway, &route).await.unwrap();
        assert_eq!(settled.batches, fleet.batch_count());
        assert_eq!(settled.left_out.len(), settled.batches / 2);
        assert!(settled.left_out[0].ends_with("is unanchored: not recognised"));
        let state = service.state.lock().unwrap();
        assert_eq!(state.batches.len(), fleet.batch_count());
        let stamps = |id: &str| {
            let scans = state.batches[id]["scans"].as_array().unwrap().clone();
            let stamp = |s: &serde_json::Value| s["stamp"].as_str().unwrap().parse().unwrap();
            scans.iter().map(stamp).collect::<Vec<Timestamp>>()
        };
        let first = fleet.drives[0].batches.iter();
        let all: Vec<_> = first.flat_map(|b| stamps(b.encoded.id.as_str())).collect();
        assert!(all.is_sorted_by(|a, b| a < b));
        assert_eq!(all.last(), Some(&now));
    }
}
