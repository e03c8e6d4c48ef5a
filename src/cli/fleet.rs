//! Simulated vehicles that drive laps and upload what they see.

mod drive;

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::Context;
use jiff::Timestamp;
use tokio::time::{Instant, sleep, sleep_until};

use super::comparison::{announce, compare};
use super::plan::Plan;
use super::progress::{Progress, say};
use crate::client::{BatchReport, Gateway};
use crate::ids::{BatchId, RouteId};
use crate::model::BatchStatus;
use crate::sim::{ChangeEvent, SimScan};
use drive::{Drive, LapBatch, LapClock};

/// How often a batch's state is asked for, and how long at most before the drive goes on.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
const POLL_MAX: Duration = Duration::from_secs(5);
/// How long to wait at the end for what is still under way.
const SETTLE_MAX: Duration = Duration::from_secs(120);

/// Vehicles with the drives they have before them.
pub(super) struct Fleet {
    drives: Vec<Drive>,
    laps: usize,
    truth: Vec<ChangeEvent>,
}

/// What became of a fleet's batches.
struct Settled {
    scans: usize,
    /// Batches that are not in the map, with the service's words.
    left_out: Vec<String>,
}

/// Tells of each alert once.
#[derive(Default)]
struct AlertWatch {
    told: BTreeSet<String>,
}

impl Fleet {
    /// Drives the laps of a plan. All vehicles but the second are told where they start. The
    /// drives end shortly before `now`.
    pub(super) fn new(plan: &Plan, now: Timestamp) -> anyhow::Result<Self> {
        let recorded: Vec<Vec<SimScan>> = (plan.vehicles.iter().zip(plan.seed..))
            .map(|(vehicle, seed)| plan.scene.drive(vehicle, 0..plan.laps, seed))
            .collect();
        let clock = LapClock::new(&recorded, now);
        let mut drives = Vec::new();
        for (k, (vehicle, scans)) in plan.vehicles.iter().zip(&recorded).enumerate() {
            let start = scans.first().filter(|_| k != 1).map(|s| s.map_from_base);
            drives.push(Drive::new(
                k + 1,
                &vehicle.lidar.geometry,
                start,
                scans,
                &clock,
            )?);
        }
        Ok(Self {
            drives,
            laps: plan.laps,
            truth: plan.scene.visible_changes(recorded.iter().flatten()),
        })
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
        let progress = Progress::new(self.batch_count() as u64, "batches");
        let gateway = gateway.notifying(progress.speaker());
        let mut watch = AlertWatch::default();
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
                for line in watch.news(&gateway, route).await? {
                    progress.say(&line);
                }
            }
        }
        progress.finish();
        Ok(())
    }

    /// Waits until nothing is under way any more, and tells what became of the drives, the map,
    /// and the changes of the world.
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
            "the map is {}: version {}, {} nodes, {} edges, {} loop closures\nlook at it: {}/map.png",
            report.stage,
            report.map_version,
            report.counts.nodes,
            report.counts.edges,
            report.counts.loop_closures,
            gateway.route_url(route),
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
            if report.status != BatchStatus::Merged.name() {
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

impl AlertWatch {
    async fn news(&mut self, gateway: &Gateway, route: &RouteId) -> anyhow::Result<Vec<String>> {
        let alerts = gateway.alerts(route).await?.unwrap_or_default();
        let news = alerts.iter().filter(|a| self.told.insert(a.id.clone()));
        Ok(news.map(announce).collect())
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
    let status = report.status.as_str();
    let became = match &report.reason {
        _ if status == BatchStatus::Merged.name() => format!(
            "merged, {} nodes and {} loop closures more",
            report.nodes_added, report.loop_closures
        ),
        Some(reason) => format!("{status}: {reason}"),
        None => status.to_owned(),
    };
    format!("  {} ({scans} scans) {became}", encoded.id)
}

#[cfg(test)]
mod tests;
