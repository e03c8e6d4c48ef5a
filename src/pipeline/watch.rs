//! Interrupts a job whose route was deleted, or that takes too long.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use tokio::time::{Instant, sleep};

use crate::solver::Interrupt;
use crate::store::{ClaimedJob, Store, StoreError};

/// How often a running job is checked.
const INTERVAL: Duration = Duration::from_secs(1);
/// A job may take this long, …
const TIME_AT_LEAST: Duration = Duration::from_secs(60);
/// … plus this much for each kilobyte of its bodies: about a hundred times what it usually takes.
const TIME_PER_KB: Duration = Duration::from_millis(100);

/// Watches over one job.
pub(super) struct Watch {
    pub store: Store,
    pub job: Arc<ClaimedJob>,
    pub interrupt: Interrupt,
}

impl Watch {
    /// Interrupts the job when its route is deleted or its time is over.
    pub async fn keep(self) {
        let deadline = Instant::now() + self.time_max();
        let began_in = self.route_created_at().await;
        loop {
            sleep(INTERVAL).await;
            // Another route may have its name by now.
            let is_gone = match (&began_in, self.route_created_at().await) {
                (Ok(Some(before)), Ok(now)) => now.is_none_or(|now| now != *before),
                (_, Ok(now)) => now.is_none(),
                (_, Err(_)) => false,
            };
            if is_gone || Instant::now() >= deadline {
                self.interrupt.raise();
                return;
            }
        }
    }

    async fn route_created_at(&self) -> Result<Option<Timestamp>, StoreError> {
        let route = self.store.route(&self.job.route_id).await?;
        Ok(route.map(|route| route.created_at))
    }

    fn time_max(&self) -> Duration {
        let bytes: usize = self.job.entries.iter().map(|entry| entry.body.len()).sum();
        let kilobytes = u32::try_from(bytes / 1_000).unwrap_or(u32::MAX);
        TIME_AT_LEAST + TIME_PER_KB * kilobytes
    }
}
