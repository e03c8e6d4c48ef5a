//! The task that keeps the gauges of the whole service current.

use std::time::Duration;

use jiff::Timestamp;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::growth::Growth;
use crate::model::{ChangeKind, Stage, Tier};
use crate::store::{DiskUse, Figures, NOT_IN_A_MAP, Store, schema_version};

/// How old a gauge may be.
const PAUSE: Duration = Duration::from_secs(15);

/// Sets the gauges from the figures of a store.
pub(super) struct Gauges {
    store: Store,
    started: Instant,
    growth: Growth,
}

impl Gauges {
    /// Of a store that was just opened.
    pub(super) fn new(store: Store) -> Self {
        let version = env!("CARGO_PKG_VERSION");
        let schema = schema_version().to_string();
        metrics::gauge!("mapshift_build_info", "version" => version, "schema" => schema).set(1.0);
        Self {
            store,
            started: Instant::now(),
            growth: Growth::default(),
        }
    }

    /// Sets them repeatedly until the service stops.
    pub(super) async fn keep_current(mut self, stopping: CancellationToken) {
        while tokio::time::timeout(PAUSE, stopping.cancelled())
            .await
            .is_err()
        {
            self.set().await;
        }
    }

    /// Sets them; those that cannot be read keep their value.
    pub(super) async fn set(&mut self) {
        match self.store.figures().await {
            Ok(figures) => {
                set_figures(&figures, Timestamp::now());
                self.set_disk(self.store.disk_use(), figures.unused_bytes);
            }
            Err(error) => tracing::warn!(%error, "the figures for the metrics could not be read"),
        }
    }

    fn set_disk(&mut self, disk: DiskUse, unused_bytes: u64) {
        let used_bytes = disk.database.saturating_sub(unused_bytes);
        self.growth.note(self.started.elapsed(), used_bytes);
        let per_day = self.growth.bytes_per_day();
        let bytes = disk.database + disk.log;
        metrics::gauge!("mapshift_database_bytes").set(bytes as f64);
        metrics::gauge!("mapshift_wal_bytes").set(disk.log as f64);
        metrics::gauge!("mapshift_database_unused_bytes").set(unused_bytes as f64);
        metrics::gauge!("mapshift_disk_growth_bytes_per_day").set(per_day.unwrap_or(f64::NAN));
        let free_bytes = disk.free.map_or(f64::NAN, |free| free as f64);
        metrics::gauge!("mapshift_disk_free_bytes").set(free_bytes);
        let days = per_day.map_or(f64::NAN, |per_day| match per_day > 0.0 {
            true => (free_bytes + unused_bytes as f64) / per_day,
            false => f64::INFINITY,
        });
        metrics::gauge!("mapshift_disk_full_in_days").set(days);
    }
}

/// Sets every value of a label, even to 0: an alert rule needs series that do not disappear.
fn set_figures(figures: &Figures, now: Timestamp) {
    let count = |count: Option<&i64>| count.copied().unwrap_or_default() as f64;
    for status in NOT_IN_A_MAP {
        metrics::gauge!("mapshift_batches", "status" => status.name())
            .set(count(figures.batches.get(&status)));
    }
    let oldest = figures.oldest_queued.map(|at| now.duration_since(at));
    let oldest_s = oldest.map_or(0.0, |age| age.as_secs_f64().max(0.0));
    metrics::gauge!("mapshift_queue_oldest_seconds").set(oldest_s);
    for kind in ChangeKind::ALL {
        for tier in Tier::ALL {
            metrics::gauge!("mapshift_open_alerts", "kind" => kind.name(), "tier" => tier.name())
                .set(count(figures.open_alerts.get(&(kind, tier))));
        }
    }
    let vehicles = [
        ("suspect", figures.suspect_vehicles),
        ("quarantined", figures.quarantined_vehicles),
    ];
    for (state, of_state) in vehicles {
        metrics::gauge!("mapshift_vehicles", "state" => state).set(of_state as f64);
    }
    for stage in Stage::ALL {
        metrics::gauge!("mapshift_routes", "stage" => stage.name())
            .set(count(figures.routes.get(&stage)));
    }
}
