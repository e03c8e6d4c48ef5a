//! The vehicles of a route: what they sent, their calibration, and whether what they send is trusted.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{name, time};
use super::error::StoreError;
use super::quarantines::{Quarantine, QuarantineOf};
use super::query::Query;
use super::trip_calibrations::{LidarRecord, VehicleCalibrations};
use super::trip_starts::NewestCorrections;
use super::vehicle_states::{KeptOut, RecentlyKeptOut, SuspectedBy, state};
use crate::calibration::{CalibratedTrip, TripCorrections};
use crate::ids::{AlertId, RouteId, VehicleId};
use crate::model::VehicleState;

/// A vehicle as a route knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleRecord {
    /// Its name.
    pub id: VehicleId,
    /// The route.
    pub route_id: RouteId,
    /// Batches that it has sent, of any status.
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

impl VehicleRecord {
    /// Whether what it sends is trusted.
    pub fn state(&self) -> VehicleState {
        let is_suspect = !self.suspected_by.is_empty() || self.kept_out.is_some();
        state(self.quarantine.is_some(), is_suspect)
    }
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
        let vehicles = Vehicles {
            route,
            after,
            only: None,
            limit,
        };
        self.read(vehicles).await
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
        let vehicles = Vehicles {
            route,
            after: None,
            only: Some(vehicle),
            limit: 1,
        };
        Ok(self.read(vehicles).await?.pop())
    }
}

/// Vehicles of a route by name: those after one, or a single one.
struct Vehicles<'a> {
    route: &'a RouteId,
    after: Option<&'a VehicleId>,
    only: Option<&'a VehicleId>,
    limit: u32,
}

impl Query for Vehicles<'_> {
    type Answer = Vec<VehicleRecord>;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT routes.route_key, vehicle_id, COUNT(*) AS batch_count, \
                 SUM(batches.scans) AS scan_count, COUNT(DISTINCT trip_id) AS trip_count, \
                 MAX(received_at_us) AS last_seen_us \
             FROM routes JOIN batches USING (route_key) \
             WHERE routes.id = $1 AND vehicle_id > $2 AND ($3 IS NULL OR vehicle_id = $3) \
             GROUP BY vehicle_id ORDER BY vehicle_id LIMIT $4",
        )
        .bind(self.route.as_str())
        .bind(self.after.map_or("", VehicleId::as_str))
        .bind(self.only.map(VehicleId::as_str))
        .bind(self.limit)
        .fetch_all(&mut *reader)
        .await?;
        let mut vehicles = Vec::with_capacity(rows.len());
        for row in &rows {
            vehicles.push(self.vehicle_of(reader, row).await?);
        }
        Ok(vehicles)
    }
}

impl Vehicles<'_> {
    async fn vehicle_of(
        &self,
        reader: &mut SqliteConnection,
        row: &SqliteRow,
    ) -> Result<VehicleRecord, StoreError> {
        let route_key = row.try_get("route_key")?;
        let (route, id) = (self.route, name(row, "vehicle_id")?);
        let vehicle = &id;
        let calibrations = VehicleCalibrations { route_key, vehicle };
        let (calibrations, lidars) = calibrations.answer(reader).await?;
        let suspected_by = SuspectedBy { route_key, vehicle };
        let suspected_by = suspected_by.answer(reader).await?;
        let quarantine = QuarantineOf { route, vehicle }.answer(reader).await?;
        let kept_out = RecentlyKeptOut { route_key, vehicle };
        let kept_out = kept_out.answer(reader).await?;
        let corrections = NewestCorrections { route_key, vehicle };
        let corrections = corrections.answer(reader).await?;
        Ok(VehicleRecord {
            id,
            route_id: route.clone(),
            batches: row.try_get("batch_count")?,
            scans: row.try_get("scan_count")?,
            trips: row.try_get("trip_count")?,
            last_seen: time(row, "last_seen_us")?,
            suspected_by,
            quarantine,
            kept_out,
            corrections,
            calibrations,
            lidars,
        })
    }
}
