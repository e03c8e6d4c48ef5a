//! The tasks that delete bodies of uploads and the scans between keyframes, and redact names of people, after
//! their retention.

use std::time::Duration;

use jiff::Timestamp;
use tokio_util::sync::CancellationToken;

use crate::store::Store;

/// How often old bodies and old names are searched for.
const POLL: Duration = Duration::from_secs(60);
/// How often all old batches are searched for scans between their keyframes.
const PASS: Duration = Duration::from_secs(60 * 60);
/// Pause between two steps: uploads and results go first.
const PAUSE: Duration = Duration::from_millis(50);

/// Deletes the bodies of batches merged longer ago than `kept`, a few at a time, until `stopping` is
/// cancelled.
pub(super) async fn delete_bodies(store: Store, kept: Duration, stopping: CancellationToken) {
    let store = &store;
    repeat(kept, &stopping, |before| delete_some(store, before)).await;
}

/// Redacts the names and addresses of people that were written longer ago than `kept`, a few at a time, until
/// `stopping` is cancelled.
pub(super) async fn redact_names(store: Store, kept: Duration, stopping: CancellationToken) {
    let store = &store;
    repeat(kept, &stopping, |before| redact_some(store, before)).await;
}

/// Takes steps with what is older than `kept` until `stopping` is cancelled; each says how long to wait before
/// the next one.
async fn repeat<Step: Future<Output = Duration>>(
    kept: Duration,
    stopping: &CancellationToken,
    step: impl Fn(Timestamp) -> Step,
) {
    loop {
        let pause = match Timestamp::now().checked_sub(kept) {
            Ok(before) => step(before).await,
            Err(_) => POLL,
        };
        let stopped = tokio::time::timeout(pause, stopping.cancelled()).await;
        if stopped.is_ok() {
            return;
        }
    }
}

/// Deletes the scans between archived keyframes of batches merged longer ago than `kept`, a few batches at
/// a time, until `stopping` is cancelled. Each pass goes through all of them: a node may be archived late.
pub(super) async fn delete_trajectories(store: Store, kept: Duration, stopping: CancellationToken) {
    let mut after = 0;
    loop {
        let deleted = match Timestamp::now().checked_sub(kept) {
            Ok(before) => delete_some_trajectories(&store, before, after).await,
            Err(_) => None,
        };
        let pause = if deleted.is_some() { PAUSE } else { PASS };
        after = deleted.unwrap_or(0);
        let stopped = tokio::time::timeout(pause, stopping.cancelled()).await;
        if stopped.is_ok() {
            return;
        }
    }
}

/// Returns where to go on; `None` at the end of a pass.
async fn delete_some_trajectories(store: &Store, before: Timestamp, after: i64) -> Option<i64> {
    match store.delete_trajectories(before, after).await {
        Ok(deleted) => {
            metrics::counter!("mapshift_trajectory_scans_deleted_total").increment(deleted.scans);
            deleted.next
        }
        Err(error) => {
            tracing::warn!(%error, "old trajectories could not be deleted");
            None
        }
    }
}

/// Returns the pause before the next step.
async fn delete_some(store: &Store, before: Timestamp) -> Duration {
    match store.delete_bodies(before).await {
        Ok(deleted) if deleted.bodies > 0 => {
            metrics::counter!("mapshift_bodies_deleted_total").increment(deleted.bodies);
            metrics::counter!("mapshift_bodies_deleted_bytes_total").increment(deleted.bytes);
            PAUSE
        }
        Ok(_) => POLL,
        Err(error) => {
            tracing::warn!(%error, "old bodies could not be deleted");
            POLL
        }
    }
}

/// Returns the pause before the next step.
async fn redact_some(store: &Store, before: Timestamp) -> Duration {
    match store.redact_names(before).await {
        Ok(0) => POLL,
        Ok(rows) => {
            metrics::counter!("mapshift_names_redacted_total").increment(rows);
            PAUSE
        }
        Err(error) => {
            tracing::warn!(%error, "old names could not be redacted");
            POLL
        }
    }
}
