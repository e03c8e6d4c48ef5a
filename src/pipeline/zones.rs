//! The task that ends expired zones.

use std::time::Duration;

use tokio_util::sync::CancellationToken;

use super::engine::now;
use crate::store::Store;

/// How often expired zones are searched for.
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
