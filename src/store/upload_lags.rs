//! How long after they were driven a vehicle's batches arrive.

use jiff::Timestamp;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::time;
use super::error::StoreError;
use super::query::Query;
use crate::ids::{RouteId, StampNs, TripId, VehicleId};

/// Most batches of an answer.
const BATCHES_MAX: i64 = 32;

/// When a batch of scans was driven by its own clock, and when it arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UploadLag {
    /// Stamp of its newest node, as it was sent.
    pub newest: StampNs,
    /// By the service's clock.
    pub received_at: Timestamp,
}

impl Store {
    /// The newest merged batches of a vehicle's previous trip, the newest first. That is the trip, other
    /// than `trip`, of which a merged batch arrived last.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn upload_lags(
        &self,
        route: &RouteId,
        vehicle: &VehicleId,
        trip: &TripId,
    ) -> Result<Vec<UploadLag>, StoreError> {
        let lags = UploadLags {
            route,
            vehicle,
            trip,
        };
        self.read(lags).await
    }
}

/// The newest batches of a vehicle's newest trip but `trip`.
pub(super) struct UploadLags<'a> {
    pub(super) route: &'a RouteId,
    pub(super) vehicle: &'a VehicleId,
    pub(super) trip: &'a TripId,
}

impl Query for UploadLags<'_> {
    type Answer = Vec<UploadLag>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "WITH newest AS (SELECT batches.route_key, trip_id FROM routes \
                 CROSS JOIN batches INDEXED BY batches_by_vehicle USING (route_key) \
                 WHERE routes.id = $1 AND vehicle_id = $2 AND trip_id <> $3 \
                 AND kind = 'scans' AND status = 'merged' AND nodes_added > 0 \
                 ORDER BY batch_key DESC LIMIT 1) \
             SELECT received_at_us, clock_ahead_ns + \
                 (SELECT max(stamp_ns) FROM nodes \
                 WHERE nodes.batch_key = batches.batch_key) AS newest \
             FROM newest JOIN trips USING (route_key, trip_id) \
                 CROSS JOIN batches INDEXED BY batches_by_trip USING (route_key, trip_id) \
             WHERE status = 'merged' AND nodes_added > 0 ORDER BY sequence DESC LIMIT $4",
        )
        .bind(self.route.as_str())
        .bind(self.vehicle.as_str())
        .bind(self.trip.as_str())
        .bind(BATCHES_MAX)
        .fetch_all(reader)
        .await?;
        let lag_of = |row| {
            Ok(UploadLag {
                newest: StampNs(Row::try_get(row, "newest")?),
                received_at: time(row, "received_at_us")?,
            })
        };
        rows.iter().map(lag_of).collect()
    }
}
