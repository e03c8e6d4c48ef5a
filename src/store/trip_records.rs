//! The trips of a route, as lists show them.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{name, time};
use super::error::StoreError;
use super::query::Query;
use crate::ids::{RouteId, StampNs, TripId, VehicleId};

/// A trip as a route knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct TripRecord {
    /// Its name.
    pub id: TripId,
    /// Whose it is.
    pub vehicle_id: VehicleId,
    /// Its batches, of any status.
    pub batches: i64,
    /// Those of them that are in the map.
    pub merged: i64,
    /// Scans in its batches.
    pub scans: i64,
    /// When the first and the last of its nodes were taken; `None` without nodes.
    pub stamps: Option<(StampNs, StampNs)>,
    /// When its first batch arrived.
    pub first_received_at: Timestamp,
    /// When its last batch arrived.
    pub last_received_at: Timestamp,
}

impl Store {
    /// A route's trips by name, after `after`, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trip_page(
        &self,
        route: &RouteId,
        after: Option<&TripId>,
        limit: u32,
    ) -> Result<Vec<TripRecord>, StoreError> {
        let page = TripPage {
            route,
            after,
            limit,
        };
        self.read(page).await
    }
}

/// Trips by name, after `after`.
struct TripPage<'a> {
    route: &'a RouteId,
    after: Option<&'a TripId>,
    limit: u32,
}

impl Query for TripPage<'_> {
    type Answer = Vec<TripRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT trips.trip_id, trips.vehicle_id, count(*) AS batch_count, \
                 sum(status = 'merged') AS merged_count, sum(batches.scans) AS scan_count, \
                 min(received_at_us) AS first_us, max(received_at_us) AS last_us, \
                 min((SELECT min(stamp_ns) FROM nodes \
                     WHERE nodes.batch_key = batches.batch_key)) AS first_ns, \
                 max((SELECT max(stamp_ns) FROM nodes \
                     WHERE nodes.batch_key = batches.batch_key)) AS last_ns \
             FROM routes JOIN trips USING (route_key) \
                 JOIN batches ON batches.route_key = trips.route_key \
                     AND batches.trip_id = trips.trip_id \
             WHERE routes.id = $1 AND trips.trip_id > $2 \
             GROUP BY trips.trip_id ORDER BY trips.trip_id LIMIT $3",
        )
        .bind(self.route.as_str())
        .bind(self.after.map_or("", TripId::as_str))
        .bind(self.limit)
        .fetch_all(reader)
        .await?;
        rows.iter().map(trip_of).collect()
    }
}

fn trip_of(row: &SqliteRow) -> Result<TripRecord, StoreError> {
    let first: Option<i64> = row.try_get("first_ns")?;
    let last: Option<i64> = row.try_get("last_ns")?;
    Ok(TripRecord {
        id: name(row, "trip_id")?,
        vehicle_id: name(row, "vehicle_id")?,
        batches: row.try_get("batch_count")?,
        merged: row.try_get("merged_count")?,
        scans: row.try_get("scan_count")?,
        stamps: first.map(StampNs).zip(last.map(StampNs)),
        first_received_at: time(row, "first_us")?,
        last_received_at: time(row, "last_us")?,
    })
}
