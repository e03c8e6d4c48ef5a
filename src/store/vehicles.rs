//! The vehicles of a route: what they sent, what their trips say of their calibration, and which
//! alerts suspect them.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{alert_id, json, json_text, name, optional_json, time};
use super::error::StoreError;
use super::quarantines::{Quarantine, quarantine_of};
use super::records::TripStart;
use super::{Store, named};
use crate::calibration::{CalibratedTrip, TRIPS_MAX, TripCalibration, TripCorrections};
use crate::ids::{AlertId, LidarId, RouteId, StampNs, TripId, VehicleId};
use crate::model::BatchStatus;

/// So many of its newest ten batches kept out make a vehicle suspect.
const KEPT_OUT_MIN: i64 = 3;

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
    pub calibrations: Vec<CalibratedTrip>,
    /// Of its mount beside the primary one's, of trips in which it was not that.
    pub beside_primary: Vec<CalibratedTrip>,
}

/// A vehicle as a route knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleRecord {
    /// Its name.
    pub id: VehicleId,
    /// The route.
    pub route_id: RouteId,
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
    /// Whether somebody keeps its uploads out of the map.
    pub quarantine: Option<Quarantine>,
    /// What became of its newest batches, if several of them were kept out.
    pub kept_out: Option<KeptOut>,
    /// What is corrected in the newest of its trips of which that has been decided.
    pub corrections: TripCorrections,
    /// What its newest trips say of its only lidar, the oldest first.
    pub calibrations: Vec<CalibratedTrip>,
    /// Its lidars, if it has named several, by name.
    pub lidars: Vec<LidarRecord>,
}

/// Uploads of a vehicle that the map does not want.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptOut {
    /// How many of the newest ten.
    pub batches: i64,
    /// Why the last of them was.
    pub reason: Option<String>,
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

    /// What was decided of a trip; `None` where nothing has been.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trip_start(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Option<TripStart>, StoreError> {
        let read = sqlx::query(
            "SELECT corrections, clock_ahead_ns FROM routes JOIN trips USING (route_key) \
             WHERE routes.id = $1 AND trip_id = $2",
        )
        .bind(route.as_str())
        .bind(trip.as_str())
        .fetch_optional(&self.shared.readers)
        .await?;
        let start = read.and_then(|row| start_of(&row).transpose());
        start.transpose()
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
             WHERE routes.id = $1 AND vehicle_id > $2 AND ($3 = '' OR vehicle_id = $3) \
             GROUP BY vehicle_id ORDER BY vehicle_id LIMIT $4",
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
                quarantine: quarantine_of(&mut reader, route, &id).await?,
                kept_out: kept_out(&mut reader, route_key, &id).await?,
                corrections: newest_corrections(&mut reader, route_key, &id).await?,
                calibrations,
                lidars,
                id,
                route_id: route.clone(),
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
         stamp_ns, scans, calibration, beside_primary) VALUES ($1, $2, $3, $4, $5, $6, $7, $8)",
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

/// Keeps what was decided of a trip; what has been decided before stands.
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

fn start_of(row: &SqliteRow) -> Result<Option<TripStart>, StoreError> {
    let corrections = optional_json(row, "corrections")?;
    let clock_ahead_ns = row.try_get("clock_ahead_ns")?;
    Ok(corrections.map(|corrections| TripStart {
        corrections,
        clock_ahead_ns,
    }))
}

async fn newest_corrections(
    reader: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<TripCorrections, StoreError> {
    let row = sqlx::query(
        "SELECT corrections FROM batches JOIN trips USING (route_key, trip_id) \
         WHERE route_key = $1 AND batches.vehicle_id = $2 AND corrections IS NOT NULL \
         ORDER BY batch_key DESC LIMIT 1",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .fetch_optional(reader)
    .await?;
    let corrections = row.map(|row| json(&row, "corrections")).transpose()?;
    Ok(corrections.unwrap_or_default())
}

/// What the newest trips of each of a route's vehicles say of each lidar: by vehicle and lidar, the
/// oldest first.
pub(super) async fn route_calibrations(
    reader: &mut SqliteConnection,
    route: &RouteId,
) -> Result<Vec<TripCalibrationRecord>, StoreError> {
    let rows = sqlx::query(
        "SELECT trip_id, vehicle_id, lidar, stamp_ns, scans, calibration, beside_primary FROM ( \
             SELECT lidar_calibrations.*, row_number() OVER ( \
                 PARTITION BY vehicle_id, lidar ORDER BY stamp_ns DESC, trip_id DESC) AS newness \
             FROM routes JOIN lidar_calibrations USING (route_key) WHERE routes.id = $1) \
         WHERE newness <= $2 ORDER BY vehicle_id, lidar, stamp_ns, trip_id",
    )
    .bind(route.as_str())
    .bind(TRIPS_MAX as i64)
    .fetch_all(reader)
    .await?;
    rows.iter().map(record_of).collect()
}

fn record_of(row: &SqliteRow) -> Result<TripCalibrationRecord, StoreError> {
    let has_name = !row.try_get::<&str, _>("lidar")?.is_empty();
    Ok(TripCalibrationRecord {
        trip_id: name(row, "trip_id")?,
        vehicle_id: name(row, "vehicle_id")?,
        lidar: has_name.then(|| name(row, "lidar")).transpose()?,
        stamp: StampNs(row.try_get("stamp_ns")?),
        scans: row.try_get("scans")?,
        calibration: json(row, "calibration")?,
        beside_primary: optional_json(row, "beside_primary")?,
    })
}

impl TripCalibrationRecord {
    /// What it says by the lidar's own scans.
    pub fn own(&self) -> CalibratedTrip {
        self.saying(self.calibration.clone())
    }

    /// What it says of the mount beside the primary one's.
    fn beside(&self) -> Option<CalibratedTrip> {
        Some(self.saying(self.beside_primary.clone()?))
    }

    fn saying(&self, calibration: TripCalibration) -> CalibratedTrip {
        CalibratedTrip {
            trip: self.trip_id.clone(),
            stamp: self.stamp,
            scans: self.scans,
            calibration,
        }
    }
}

/// Those of a vehicle's only lidar, and its lidars with names.
async fn calibrations(
    reader: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<(Vec<CalibratedTrip>, Vec<LidarRecord>), StoreError> {
    let rows = sqlx::query(
        "SELECT trip_id, vehicle_id, lidar, stamp_ns, scans, calibration, beside_primary FROM ( \
             SELECT *, row_number() OVER ( \
                 PARTITION BY lidar ORDER BY stamp_ns DESC, trip_id DESC) AS newness \
             FROM lidar_calibrations WHERE route_key = $1 AND vehicle_id = $2) \
         WHERE newness <= $3 ORDER BY lidar, stamp_ns, trip_id",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .bind(TRIPS_MAX as i64)
    .fetch_all(reader)
    .await?;
    let mut of_only_one = Vec::new();
    let mut lidars: Vec<LidarRecord> = Vec::new();
    for row in &rows {
        let record = record_of(row)?;
        let Some(id) = record.lidar.clone() else {
            of_only_one.push(record.own());
            continue;
        };
        if lidars.last().is_none_or(|last| last.id != id) {
            lidars.push(LidarRecord {
                id,
                calibrations: Vec::new(),
                beside_primary: Vec::new(),
            });
        }
        if let Some(lidar) = lidars.last_mut() {
            lidar.calibrations.push(record.own());
            lidar.beside_primary.extend(record.beside());
        }
    }
    Ok((of_only_one, lidars))
}

/// What became of a vehicle's newest ten batches of which something has, if three were kept out.
pub(super) async fn kept_out(
    reader: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<Option<KeptOut>, StoreError> {
    let rows: Vec<(String, Option<String>)> = sqlx::query_as(
        "SELECT status, reason FROM batches \
         WHERE route_key = $1 AND vehicle_id = $2 \
         AND status IN ('merged', 'unanchored', 'quarantined') \
         ORDER BY batch_key DESC LIMIT 10",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .fetch_all(reader)
    .await?;
    let mut reasons = rows
        .into_iter()
        .filter(|(status, _)| *status == BatchStatus::Quarantined.name())
        .map(|(_, reason)| reason);
    let Some(reason) = reasons.next() else {
        return Ok(None);
    };
    let batches = 1 + reasons.count() as i64;
    Ok((batches >= KEPT_OUT_MIN).then_some(KeptOut { batches, reason }))
}

/// The undecided alerts that suspect a vehicle.
pub(super) async fn suspected_by(
    reader: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<Vec<AlertId>, StoreError> {
    let rows = sqlx::query(
        "SELECT alerts.id FROM alerts WHERE route_key = $1 AND kind = 'vehicle_suspect' \
         AND status IN ('open', 'acknowledged') \
         AND EXISTS (SELECT 1 FROM json_each(alerts.vehicles) WHERE value = $2) ORDER BY id",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .fetch_all(reader)
    .await?;
    rows.iter().map(|row| alert_id(row, "id")).collect()
}
