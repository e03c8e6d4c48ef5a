//! What is decided of a trip when its first scans are processed: corrections, and its clock.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{json, json_text, optional_json};
use super::error::StoreError;
use super::query::Query;
use super::records::TripStart;
use crate::calibration::TripCorrections;
use crate::ids::{RouteId, TripId, VehicleId};

impl Store {
    /// What was decided of a trip; `None` where nothing has been.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trip_start(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Option<TripStart>, StoreError> {
        self.read(StartOfTrip { route, trip }).await
    }
}

/// What was decided of a trip.
struct StartOfTrip<'a> {
    route: &'a RouteId,
    trip: &'a TripId,
}

impl Query for StartOfTrip<'_> {
    type Answer = Option<TripStart>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(
            "SELECT corrections, clock_ahead_ns FROM routes JOIN trips USING (route_key) \
             WHERE routes.id = $1 AND trip_id = $2",
        )
        .bind(self.route.as_str())
        .bind(self.trip.as_str())
        .fetch_optional(reader)
        .await?;
        let start = row.and_then(|row| start_of(&row).transpose());
        start.transpose()
    }
}

fn start_of(row: &SqliteRow) -> Result<Option<TripStart>, StoreError> {
    let corrections = optional_json(row, "corrections")?;
    let clock_ahead_ns = row.try_get("clock_ahead_ns")?;
    Ok(corrections.map(|corrections| TripStart {
        corrections,
        clock_ahead_ns,
    }))
}

/// What is corrected in the newest of a vehicle's trips of which that has been decided.
pub(super) struct NewestCorrections<'a> {
    pub(super) route_key: i64,
    pub(super) vehicle: &'a VehicleId,
}

impl Query for NewestCorrections<'_> {
    type Answer = TripCorrections;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(
            "SELECT corrections FROM batches JOIN trips USING (route_key, trip_id) \
             WHERE route_key = $1 AND batches.vehicle_id = $2 AND corrections IS NOT NULL \
             ORDER BY batch_key DESC LIMIT 1",
        )
        .bind(self.route_key)
        .bind(self.vehicle.as_str())
        .fetch_optional(reader)
        .await?;
        let corrections = row.map(|row| json(&row, "corrections")).transpose()?;
        Ok(corrections.unwrap_or_default())
    }
}

/// Writes what was decided of a trip; what was decided earlier stays.
pub(super) async fn put_trip_start(
    transaction: &mut SqliteConnection,
    route_key: i64,
    trip: &TripId,
    start: &TripStart,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE trips SET corrections = $1, clock_ahead_ns = $2 \
         WHERE route_key = $3 AND trip_id = $4 AND corrections IS NULL",
    )
    .bind(json_text(&start.corrections)?)
    .bind(start.clock_ahead_ns)
    .bind(route_key)
    .bind(trip.as_str())
    .execute(transaction)
    .await?;
    Ok(())
}
