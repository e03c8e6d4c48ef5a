//! What trips say of the calibration of their vehicles, lidar by lidar.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{json, name, optional_json};
use super::error::StoreError;
use super::query::Query;
use crate::calibration::{CalibratedTrip, TRIPS_MAX, TripCalibration};
use crate::ids::{LidarId, RouteId, StampNs, TripId, VehicleId};

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

/// Writes what a trip says; what the same trip said earlier is replaced.
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

/// What the newest trips of each of a route's vehicles say of each lidar: by vehicle and lidar, the
/// oldest first.
pub(super) struct RouteCalibrations<'a>(pub(super) &'a RouteId);

impl Query for RouteCalibrations<'_> {
    type Answer = Vec<TripCalibrationRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
        "SELECT trip_id, vehicle_id, lidar, stamp_ns, scans, calibration, beside_primary FROM ( \
             SELECT lidar_calibrations.*, row_number() OVER ( \
                 PARTITION BY vehicle_id, lidar ORDER BY stamp_ns DESC, trip_id DESC) AS newness \
             FROM routes JOIN lidar_calibrations USING (route_key) WHERE routes.id = $1) \
         WHERE newness <= $2 ORDER BY vehicle_id, lidar, stamp_ns, trip_id",
    )
    .bind(self.0.as_str())
    .bind(TRIPS_MAX as i64)
    .fetch_all(reader)
    .await?;
        rows.iter().map(record_of).collect()
    }
}

/// What a vehicle's newest trips say of its only lidar, and of each of its lidars with names.
pub(super) struct VehicleCalibrations<'a> {
    pub(super) route_key: i64,
    pub(super) vehicle: &'a VehicleId,
}

impl Query for VehicleCalibrations<'_> {
    type Answer = (Vec<CalibratedTrip>, Vec<LidarRecord>);

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
        "SELECT trip_id, vehicle_id, lidar, stamp_ns, scans, calibration, beside_primary FROM ( \
             SELECT *, row_number() OVER ( \
                 PARTITION BY lidar ORDER BY stamp_ns DESC, trip_id DESC) AS newness \
             FROM lidar_calibrations WHERE route_key = $1 AND vehicle_id = $2) \
         WHERE newness <= $3 ORDER BY lidar, stamp_ns, trip_id",
    )
    .bind(self.route_key)
    .bind(self.vehicle.as_str())
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
