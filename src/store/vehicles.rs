//! The vehicles of a route: what they sent, what their trips say of their calibration, and which
//! alerts suspect them.

use jiff::Timestamp;
use sqlx::{Row, SqliteConnection};

use super::columns::{alert_id, json, name, optional_json, time};
use super::error::StoreError;
use super::{Store, named};
use crate::calibration::TripCalibration;
use crate::ids::{AlertId, LidarId, RouteId, StampNs, TripId, VehicleId};

/// So many of the newest trips of a vehicle's lidar say how it is calibrated.
const TRIPS_MAX: u32 = 20;

/// What a trip says of its vehicle by one of its lidars, as a result brings it.
#[derive(Debug, Clone, PartialEq)]
pub struct TripCalibrationRecord {
    /// The trip.
    pub trip_id: TripId,
    /// Whose it is.
    pub vehicle_id: VehicleId,
    /// Which lidar's scans say it; `None` for the vehicle's only one.
    pub lidar: Option<LidarId>,
    /// When the newest scan that it rests on was taken.
    pub stamp: StampNs,
    /// Scans that it rests on.
    pub scans: u32,
    /// The estimates.
    pub calibration: TripCalibration,
    /// How the mount differs from the stated one beside the lidar that takes the trip's keyframes;
    /// `None` for that one.
    pub beside_primary: Option<TripCalibration>,
}

/// What a vehicle's newest trips say of one of its several lidars, the oldest first.
#[derive(Debug, Clone, PartialEq)]
pub struct LidarRecord {
    /// As the vehicle names it.
    pub id: LidarId,
    /// By its own scans and the odometry.
    pub calibrations: Vec<TripCalibration>,
    /// Of its mount beside the primary one's, of trips in which it was not that.
    pub beside_primary: Vec<TripCalibration>,
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
    /// What its newest trips say of its only lidar, the oldest first.
    pub calibrations: Vec<TripCalibration>,
    /// Its lidars, if it has named several, by name.
    pub lidars: Vec<LidarRecord>,
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
            let (calibrations, lidars) = calibrations(&mut reader, route_key, &id).await?;
            vehicles.push(VehicleRecord {
                batches: row.try_get("batch_count")?,
                scans: row.try_get("scan_count")?,
                trips: row.try_get("trip_count")?,
                last_seen: time(row, "last_seen_us")?,
                suspected_by: suspected_by(&mut reader, route_key, &id).await?,
                calibrations,
                lidars,
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
    let json = |calibration: &TripCalibration| {
        serde_json::to_string(calibration)
            .map_err(|error| StoreError::InvalidResult(format!("it has no JSON: {error}")))
    };
    let calibration = json(&record.calibration)?;
    let beside_primary = record.beside_primary.as_ref().map(json).transpose()?;
    sqlx::query(
        "INSERT OR REPLACE INTO lidar_calibrations (route_key, trip_id, lidar, vehicle_id, \
         stamp_ns, scans, calibration, beside_primary) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(route_key)
    .bind(record.trip_id.as_str())
    .bind(record.lidar.as_ref().map_or("", LidarId::as_str))
    .bind(record.vehicle_id.as_str())
    .bind(record.stamp.0)
    .bind(record.scans)
    .bind(calibration)
    .bind(beside_primary)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Those of a vehicle's only lidar, and its lidars with names.
async fn calibrations(
    reader: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<(Vec<TripCalibration>, Vec<LidarRecord>), StoreError> {
    let rows = sqlx::query(
        "SELECT lidar, calibration, beside_primary FROM ( \
             SELECT *, row_number() OVER (PARTITION BY lidar ORDER BY stamp_ns DESC) AS newness \
             FROM lidar_calibrations WHERE route_key = ? AND vehicle_id = ?) \
         WHERE newness <= ? ORDER BY lidar, stamp_ns",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .bind(TRIPS_MAX)
    .fetch_all(reader)
    .await?;
    let mut of_only_one = Vec::new();
    let mut lidars: Vec<LidarRecord> = Vec::new();
    for row in &rows {
        let calibration = json(row, "calibration")?;
        if row.try_get::<&str, _>("lidar")?.is_empty() {
            of_only_one.push(calibration);
            continue;
        }
        let id: LidarId = name(row, "lidar")?;
        if lidars.last().is_none_or(|last| last.id != id) {
            lidars.push(LidarRecord {
                id,
                calibrations: Vec::new(),
                beside_primary: Vec::new(),
            });
        }
        if let Some(lidar) = lidars.last_mut() {
            lidar.calibrations.push(calibration);
            lidar
                .beside_primary
                .extend(optional_json(row, "beside_primary")?);
        }
    }
    Ok((of_only_one, lidars))
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
