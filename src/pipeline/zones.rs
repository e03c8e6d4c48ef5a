//! The task that ends zones whose time is over.

use std::time::Duration;

use tokio_util::sync::CancellationToken;

use super::engine::now;
use crate::store::Store;

/// How often it is asked whether a zone's time is over.
const PAUSE: Duration = Duration::from_secs(1);

/// Ends zones until the service stops.
pub(super) async fn end_in_time(store: Store, stopping: CancellationToken) {
    while tokio::time::timeout(PAUSE, stopping.cancelled())
        .await
        .is_err()
    {
        match store.end_zones(now()).await {
            Ok(0) => {}
            Ok(zones) => tracing::info!(zones, "the time of zones is over"),
            Err(error) => tracing::warn!(%error, "zones could not be ended"),
        }
    }
}
