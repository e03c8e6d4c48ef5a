//! Trips whose clock was found to be behind while they were driven, and how late batches of a fleet arrive.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::columns::{name, time};
use super::error::StoreError;
use super::query::Query;
use super::upload_lags::{UploadLag, UploadLags};
use crate::ids::{RouteId, StampNs, TripId, VehicleId};

/// Most batches of a trip that are asked.
const BATCHES_MAX: i64 = 32;
/// Most other vehicles that are asked.
const VEHICLES_MAX: i64 = 64;

/// A trip whose clock is behind.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClockFault {
    /// The trip.
    pub trip: TripId,
    /// Its vehicle.
    pub vehicle: VehicleId,
    /// How much later than they are stamped its batches arrive, nanoseconds.
    pub behind_ns: i64,
    /// Stamp of its first scan.
    pub since: StampNs,
    /// Stamp of its newest scan when that was found.
    pub last_seen: StampNs,
    /// Its scans in the map then.
    pub scans: u32,
    /// Stamp of the first scan of the vehicle's next trip that arrived as it was driven; `None` while there
    /// is none.
    pub until: Option<StampNs>,
}

impl Store {
    /// How late the batches of a trip arrived that are in the map, the newest first.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn trip_lags(
        &self,
        route: &RouteId,
        trip: &TripId,
    ) -> Result<Vec<UploadLag>, StoreError> {
        self.read(TripLags { route, trip }).await
    }

    /// The same of the newest trip of each vehicle of a route but one, at most 64 of them.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn lags_of_others(
        &self,
        route: &RouteId,
        vehicle: &VehicleId,
        trip: &TripId,
    ) -> Result<Vec<Vec<UploadLag>>, StoreError> {
        self.read(LagsOfOthers {
            route,
            vehicle,
            trip,
        })
        .await
    }
}

struct TripLags<'a> {
    route: &'a RouteId,
    trip: &'a TripId,
}

impl Query for TripLags<'_> {
    type Answer = Vec<UploadLag>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Vec<UploadLag>, StoreError> {
        let rows = sqlx::query(
            "SELECT received_at_us, clock_ahead_ns + \
                 (SELECT max(stamp_ns) FROM nodes WHERE nodes.batch_key = batches.batch_key) AS newest \
             FROM routes JOIN trips USING (route_key) \
                 CROSS JOIN batches INDEXED BY batches_by_trip USING (route_key, trip_id) \
             WHERE routes.id = $1 AND trip_id = $2 AND kind = 'scans' \
                 AND status = 'merged' AND nodes_added > 0 \
             ORDER BY sequence DESC LIMIT $3",
        )
        .bind(self.route.as_str())
        .bind(self.trip.as_str())
        .bind(BATCHES_MAX)
        .fetch_all(reader)
        .await?;
        let lag_of = |row: &SqliteRow| {
            Ok(UploadLag {
                newest: StampNs(row.try_get("newest")?),
                received_at: time(row, "received_at_us")?,
            })
        };
        rows.iter().map(lag_of).collect()
    }
}

struct LagsOfOthers<'a> {
    route: &'a RouteId,
    vehicle: &'a VehicleId,
    trip: &'a TripId,
}

impl Query for LagsOfOthers<'_> {
    type Answer = Vec<Vec<UploadLag>>;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(
        &self,
        reader: &mut SqliteConnection,
    ) -> Result<Vec<Vec<UploadLag>>, StoreError> {
        // The recursion steps from one vehicle to the next along the index.
        let rows = sqlx::query(
            "WITH RECURSIVE \
                 route AS (SELECT route_key FROM routes WHERE id = $1), \
                 vehicle(vehicle_id) AS ( \
                     SELECT min(vehicle_id) FROM batches WHERE route_key = (SELECT route_key FROM route) \
                     UNION ALL \
                     SELECT (SELECT min(vehicle_id) FROM batches \
                         WHERE route_key = (SELECT route_key FROM route) \
                             AND batches.vehicle_id > vehicle.vehicle_id) \
                     FROM vehicle WHERE vehicle.vehicle_id IS NOT NULL) \
             SELECT vehicle_id FROM vehicle \
             WHERE vehicle_id IS NOT NULL AND vehicle_id <> $2 LIMIT $3",
        )
        .bind(self.route.as_str())
        .bind(self.vehicle.as_str())
        .bind(VEHICLES_MAX)
        .fetch_all(&mut *reader)
        .await?;
        let mut lags = Vec::with_capacity(rows.len());
        for row in &rows {
            let other: VehicleId = name(row, "vehicle_id")?;
            let lags_of_other = UploadLags {
                route: self.route,
                vehicle: &other,
                trip: self.trip,
            };
            lags.push(lags_of_other.answer(reader).await?);
        }
        Ok(lags)
    }
}

/// Those of a route, by trip.
pub(super) struct ClockFaults<'a>(pub(super) &'a RouteId);

impl Query for ClockFaults<'_> {
    type Answer = Vec<ClockFault>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT trip_id, vehicle_id, behind_ns, since_ns, last_seen_ns, clock_faults.scans, \
                 until_ns \
             FROM routes JOIN clock_faults USING (route_key) WHERE routes.id = $1 ORDER BY trip_id",
        )
        .bind(self.0.as_str())
        .fetch_all(reader)
        .await?;
        rows.iter().map(fault_of).collect()
    }
}

fn fault_of(row: &SqliteRow) -> Result<ClockFault, StoreError> {
    let until: Option<i64> = row.try_get("until_ns")?;
    Ok(ClockFault {
        trip: name(row, "trip_id")?,
        vehicle: name(row, "vehicle_id")?,
        behind_ns: row.try_get("behind_ns")?,
        since: StampNs(row.try_get("since_ns")?),
        last_seen: StampNs(row.try_get("last_seen_ns")?),
        scans: row.try_get("scans")?,
        until: until.map(StampNs),
    })
}

/// Keeps what was found of a trip's clock; what was found before is replaced.
pub(super) async fn put_clock_fault(
    transaction: &mut SqliteConnection,
    route_key: i64,
    fault: &ClockFault,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT OR REPLACE INTO clock_faults (route_key, trip_id, vehicle_id, behind_ns, since_ns, \
             last_seen_ns, scans, until_ns) VALUES ($1, $2, $3, $4, $5, $6, $7, $8)",
    )
    .bind(route_key)
    .bind(fault.trip.as_str())
    .bind(fault.vehicle.as_str())
    .bind(fault.behind_ns)
    .bind(fault.since.0)
    .bind(fault.last_seen.0)
    .bind(fault.scans)
    .bind(fault.until.map(|until| until.0))
    .execute(transaction)
    .await?;
    Ok(())
}
