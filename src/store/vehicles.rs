//! The vehicles of a route: what they sent, what their trips say of their calibration, and which
//! alerts suspect them.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{alert_id, json, name, time};
use super::error::StoreError;
use super::{Store, named};
use crate::calibration::TripCalibration;
use crate::ids::{AlertId, RouteId, StampNs, TripId, VehicleId};

/// So many of a vehicle's newest trips say how it is calibrated.
const TRIPS_MAX: u32 = 20;

/// What a trip says of its vehicle, as a result brings it.
#[derive(Debug, Clone, PartialEq)]
pub struct TripCalibrationRecord {
    /// The trip.
    pub trip_id: TripId,
    /// Whose it is.
    pub vehicle_id: VehicleId,
    /// When the newest scan that it rests on was taken.
    pub stamp: StampNs,
    /// Scans that it rests on.
    pub scans: u32,
    /// The estimates.
    pub calibration: TripCalibration,
}

/// A vehicle as a route knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleRecord {
    /// Its name.
    pub id: VehicleId,
    /// Batches it has sent, whatever became of them.
    pub batches: i64,
    /// Scans in them.
    pub scans: i64,
    /// Its trips.
    pub trips: i64,
    /// When its last batch arrived.
    pub last_seen: Timestamp,
    /// Undecided alerts that suspect it.
    pub suspected_by: Vec<AlertId>,
    /// What its newest trips say, the oldest first.
    pub calibrations: Vec<TripCalibration>,
}

impl Store {
    /// A route's vehicles by name, after `after`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn vehicle_page(
        &self,
        route: &RouteId,
        after: Option<&VehicleId>,
        limit: u32,
    ) -> Result<Vec<VehicleRecord>, StoreError> {
        let after = after.map_or("", VehicleId::as_str);
        named(self.vehicles(route, after, "", limit).await)
    }

    /// One vehicle of a route.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn vehicle(
        &self,
        route: &RouteId,
        vehicle: &VehicleId,
    ) -> Result<Option<VehicleRecord>, StoreError> {
        let found = self.vehicles(route, "", vehicle.as_str(), 1).await;
        Ok(named(found)?.pop())
    }

    /// The vehicles after a name, or the one of a name that is not empty.
    async fn vehicles(
        &self,
        route: &RouteId,
        after: &str,
        only: &str,
        limit: u32,
    ) -> Result<Vec<VehicleRecord>, StoreError> {
        // One transaction, so that a vehicle and its calibration are of one moment.
        let mut reader = self.shared.readers.begin().await?;
        let rows = sqlx::query(
            "SELECT routes.route_key, vehicle_id, COUNT(*) AS batch_count, \
                 SUM(batches.scans) AS scan_count, COUNT(DISTINCT trip_id) AS trip_count, \
                 MAX(received_at_us) AS last_seen_us \
             FROM routes JOIN batches USING (route_key) \
             WHERE routes.id = ?1 AND vehicle_id > ?2 AND (?3 = '' OR vehicle_id = ?3) \
             GROUP BY vehicle_id ORDER BY vehicle_id LIMIT ?4",
        )
        .bind(route.as_str())
        .bind(after)
        .bind(only)
        .bind(limit)
        .fetch_all(&mut *reader)
        .await?;
        let mut vehicles = Vec::with_capacity(rows.len());
        for row in &rows {
            let route_key: i64 = row.try_get("route_key")?;
            let id: VehicleId = name(row, "vehicle_id")?;
            vehicles.push(VehicleRecord {
                batches: row.try_get("batch_count")?,
                scans: row.try_get("scan_count")?,
                trips: row.try_get("trip_count")?,
                last_seen: time(row, "last_seen_us")?,
                suspected_by: suspected_by(&mut reader, route_key, &id).await?,
                calibrations: calibrations(&mut reader, route_key, &id).await?,
                id,
            });
        }
        Ok(vehicles)
    }
}

/// Keeps what a trip says; an earlier word of the same trip is replaced.
pub(super) async fn put_calibration(
    transaction: &mut SqliteConnection,
    route_key: i64,
    record: &TripCalibrationRecord,
) -> Result<(), StoreError> {
    // An estimate need not come back to the bit.
    let calibration = serde_json::to_string(&record.calibration)
        .map_err(|error| StoreError::InvalidResult(format!("it has no JSON: {error}")))?;
    sqlx::query(
        "INSERT OR REPLACE INTO trip_calibrations \
         (route_key, trip_id, vehicle_id, stamp_ns, scans, calibration) VALUES (?, ?, ?, ?, ?, ?)",
    )
    .bind(route_key)
    .bind(record.trip_id.as_str())
    .bind(record.vehicle_id.as_str())
    .bind(record.stamp.0)
    .bind(record.scans)
    .bind(calibration)
    .execute(transaction)
    .await?;
    Ok(())
}

async fn calibrations(
    reader: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<Vec<TripCalibration>, StoreError> {
    let rows = sqlx::query(
        "SELECT calibration FROM trip_calibrations WHERE route_key = ? AND vehicle_id = ? \
         ORDER BY stamp_ns DESC LIMIT ?",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .bind(TRIPS_MAX)
    .fetch_all(reader)
    .await?;
    let of_row = |row: &SqliteRow| json(row, "calibration");
    rows.iter().rev().map(of_row).collect()
}

async fn suspected_by(
    reader: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<Vec<AlertId>, StoreError> {
    let rows = sqlx::query(
        "SELECT alerts.id FROM alerts WHERE route_key = ? AND kind = 'vehicle_suspect' \
         AND status IN ('open', 'acknowledged') \
         AND EXISTS (SELECT 1 FROM json_each(alerts.vehicles) WHERE value = ?) ORDER BY id",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .fetch_all(reader)
    .await?;
    rows.iter().map(|row| alert_id(row, "id")).collect()
}
