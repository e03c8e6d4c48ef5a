//! Simulated vehicles that drive laps and upload their scans.

mod drive;
mod watch;

use std::time::Duration;

use anyhow::Context;
use jiff::Timestamp;
use tokio::time::{Instant, sleep, sleep_until};

use super::comparison::{Knocked, Truth, compare};
use super::plan::Plan;
use super::progress::{Progress, say};
use crate::client::{BatchReport, Gateway};
use crate::ids::{BatchId, RouteId};
use crate::model::BatchStatus;
use crate::sim::SimScan;
use drive::{Drive, LapBatch, LapClock};
use watch::AlertWatch;

/// How often a batch's state is polled, and for how long at most before the run continues.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
const POLL_MAX: Duration = Duration::from_secs(5);
/// How long to wait at the end for batches that are still being processed.
const SETTLE_MAX: Duration = Duration::from_secs(120);

/// Vehicles with the trips that they will drive.
pub(super) struct Fleet {
    drives: Vec<Drive>,
    laps: usize,
    truth: Truth,
}

/// The outcome of a fleet's batches.
struct Settled {
    scans: usize,
    /// Batches that are not in the map, with the service's reason.
    left_out: Vec<String>,
}

impl Fleet {
    /// The trips of a plan, one for each lap. The second vehicle does not know where its first lap starts. The
    /// trips end shortly before `now`.
    pub(super) fn new(plan: &Plan, now: Timestamp) -> anyhow::Result<Self> {
        let recorded: Vec<Vec<SimScan>> = (0..plan.vehicles.len())
            .map(|number| plan.drive(number))
            .collect();
        let clock = LapClock::new(&recorded, now);
        let mut drives = Vec::new();
        for (k, (vehicle, scans)) in plan.vehicles.iter().zip(&recorded).enumerate() {
            let lidar = &vehicle.lidar.geometry;
            drives.push(Drive::new(k + 1, lidar, k != 1, scans, &clock)?);
        }
        let last = drives.last().zip(plan.knocked_lap);
        let knocked = last.map(|(drive, lap)| Knocked {
            vehicle: drive.vehicle_id.clone(),
            lap,
        });
        Ok(Self {
            drives,
            laps: plan.laps,
            truth: Truth {
                changes: plan.scene.visible_changes(recorded.iter().flatten()),
                knocked,
            },
        })
    }

    /// Batches in all trips.
    pub(super) fn batch_count(&self) -> usize {
        self.drives.iter().map(|d| d.batches.len()).sum()
    }

    /// Uploads lap after lap, one vehicle after the other, a batch every `pace`. Prints what is different in a
    /// lap, what the service reports, and which batches are not in the map.
    pub(super) async fn drive(
        &self,
        gateway: &Gateway,
        route: &RouteId,
        pace: Duration,
    ) -> anyhow::Result<()> {
        let progress = Progress::new(self.batch_count() as u64, "batches");
        let gateway = gateway.notifying(progress.speaker());
        let mut watch = AlertWatch::default();
        for lap in 0..self.laps {
            let happens = self.truth.before_lap(lap);
            progress.say(&format!("lap {} of {}{happens}", lap + 1, self.laps));
            for drive in &self.drives {
                for batch in drive.batches.iter().filter(|b| b.lap == lap) {
                    let next = Instant::now() + pace;
                    gateway.put_batch(route, &batch.encoded).await?;
                    let report = report_of(&gateway, route, &batch.encoded.id).await?;
                    if let Some(line) = left_out(batch, &report) {
                        progress.say(&format!("  {line}"));
                    }
                    progress.advance(1);
                    sleep_until(next).await;
                }
                for line in watch.news(&gateway, route).await? {
                    progress.say(&format!("  {line}"));
                }
            }
        }
        progress.finish();
        Ok(())
    }

    /// Waits until all batches are processed, and prints the outcome of the trips, the map, and the changes of
    /// the world.
    pub(super) async fn report(&self, gateway: &Gateway, route: &RouteId) -> anyhow::Result<()> {
        let settled = self.settle(gateway, route).await?;
        let report = gateway.route(route).await?;
        say(&format!(
            "{} batches with {} scans are {}",
            self.batch_count(),
            settled.scans,
            if settled.left_out.is_empty() {
                "all in the map"
            } else {
                "stored"
            },
        ));
        for line in &settled.left_out {
            say(&format!("  {line}"));
        }
        say(&format!(
            "the route is in stage {}: map version {}, {} nodes, {} loop closures",
            report.stage, report.map_version, report.counts.nodes, report.counts.loop_closures,
        ));
        let alerts = gateway.alerts(route).await?;
        for line in compare(&self.truth, alerts.as_deref()) {
            say(&line);
        }
        Ok(())
    }

    async fn settle(&self, gateway: &Gateway, route: &RouteId) -> anyhow::Result<Settled> {
        let give_up = Instant::now() + SETTLE_MAX;
        while gateway.route(route).await?.pending_batches > 0 {
            if Instant::now() > give_up {
                say("some batches are still under way");
                break;
            }
            sleep(4 * POLL_INTERVAL).await;
        }
        let mut settled = Settled {
            scans: 0,
            left_out: Vec::new(),
        };
        for batch in self.drives.iter().flat_map(|d| &d.batches) {
            settled.scans += batch.scans;
            let report = gateway.batch(route, &batch.encoded.id).await?;
            settled.left_out.extend(left_out(batch, &report));
        }
        Ok(settled)
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

/// Why a batch is not in the map.
fn left_out(batch: &LapBatch, report: &BatchReport) -> Option<String> {
    if report.status == BatchStatus::Merged.name() {
        return None;
    }
    let reason = report
        .reason
        .as_deref()
        .unwrap_or("no reason is stated yet");
    Some(format!(
        "{} is {}: {reason}",
        batch.encoded.id, report.status
    ))
}

#[cfg(test)]
mod tests;
