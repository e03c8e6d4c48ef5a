//! The task that deletes what is known of deliveries when its time is over.

use std::time::Duration;

use jiff::Timestamp;
use tokio_util::sync::CancellationToken;

use crate::store::Store;

/// How long deliveries are kept: long enough to look into a failure after a holiday.
const KEPT: Duration = Duration::from_hours(30 * 24);
/// How often old ones are looked for.
const LOOK: Duration = Duration::from_mins(10);
/// Between two steps: other writes go first.
const PAUSE: Duration = Duration::from_millis(50);

/// Deletes old deliveries, some at a time, until `stopping` is cancelled.
pub(super) async fn delete_old(store: Store, stopping: CancellationToken) {
    loop {
        let pause = delete_some(&store).await;
        let stopped = tokio::time::timeout(pause, stopping.cancelled()).await;
        if stopped.is_ok() {
            return;
        }
    }
}

/// Returns when to look again.
async fn delete_some(store: &Store) -> Duration {
    let Ok(before) = Timestamp::now().checked_sub(KEPT) else {
        return LOOK;
    };
    if let Err(error) = store.delete_previous_secrets(Timestamp::now()).await {
        tracing::warn!(%error, "secrets that are not valid any more could not be deleted");
    }
    match store.delete_deliveries(before).await {
        Ok(0) => LOOK,
        Ok(_) => PAUSE,
        Err(error) => {
            tracing::warn!(%error, "old deliveries could not be deleted");
            LOOK
        }
    }
}
