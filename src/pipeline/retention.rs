//! The task that deletes bodies of uploads when their time is over.

use std::time::Duration;

use jiff::Timestamp;
use tokio_util::sync::CancellationToken;

use crate::store::Store;

/// How often old bodies are looked for.
const LOOK: Duration = Duration::from_secs(60);
/// Between two steps: uploads and results go first.
const PAUSE: Duration = Duration::from_millis(50);

/// Deletes the bodies of batches merged longer ago than `kept`, a few at a time, until it is told
/// to stop.
pub(super) async fn delete_bodies(store: Store, kept: Duration, stopping: CancellationToken) {
    loop {
        let pause = match Timestamp::now().checked_sub(kept) {
            Ok(before) => delete_some(&store, before).await,
            Err(_) => LOOK,
        };
        let stopped = tokio::time::timeout(pause, stopping.cancelled()).await;
        if stopped.is_ok() {
            return;
        }
    }
}

/// Returns when to look again.
async fn delete_some(store: &Store, before: Timestamp) -> Duration {
    match store.delete_bodies(before).await {
        Ok(deleted) if deleted.bodies > 0 => {
            metrics::counter!("mapshift_bodies_deleted_total").increment(deleted.bodies);
            metrics::counter!("mapshift_bodies_deleted_bytes_total").increment(deleted.bytes);
            PAUSE
        }
        Ok(_) => LOOK,
        Err(error) => {
            tracing::warn!(%error, "old bodies could not be deleted");
            LOOK
        }
    }
}
