//! The task that deletes bodies of uploads after their retention.

use std::time::Duration;

use jiff::Timestamp;
use tokio_util::sync::CancellationToken;

use crate::store::Store;

/// How often old bodies are searched for.
const POLL: Duration = Duration::from_secs(60);
/// Pause between two steps: uploads and results go first.
const PAUSE: Duration = Duration::from_millis(50);

/// Deletes the bodies of batches merged longer ago than `kept`, a few at a time, until `stopping` is
/// cancelled.
pub(super) async fn delete_bodies(store: Store, kept: Duration, stopping: CancellationToken) {
    loop {
        let pause = match Timestamp::now().checked_sub(kept) {
            Ok(before) => delete_some(&store, before).await,
            Err(_) => POLL,
        };
        let stopped = tokio::time::timeout(pause, stopping.cancelled()).await;
        if stopped.is_ok() {
            return;
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
