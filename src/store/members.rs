//! The batches that a job may end.

use std::collections::BTreeMap;

use sqlx::{Row, SqliteConnection};

use super::columns::name;
use super::error::StoreError;
use super::trips::Place;
use crate::ids::{BatchId, TripId, VehicleId};

/// A batch that a job may end, as new nodes and edges must name it.
pub(super) struct Member {
    pub(super) batch_key: i64,
    pub(super) vehicle_id: VehicleId,
    pub(super) trip_id: TripId,
}

/// The batches that a job may end.
pub(super) type Members = BTreeMap<BatchId, Member>;

/// The job's own batch and those that it takes along: the unanchored ones of its trip, or of a job of
/// edges those of its vehicle.
pub(super) async fn members(
    transaction: &mut SqliteConnection,
    place: &Place,
) -> Result<Members, StoreError> {
    let rows = sqlx::query(
        "SELECT batch_key, id, vehicle_id, trip_id FROM batches \
         WHERE (route_key = $1 AND trip_id = $2 AND status = 'unanchored' AND kind = 'scans') \
         OR (route_key = $1 AND status = 'unanchored' AND kind = 'edges' AND (vehicle_id, kind) = \
             (SELECT vehicle_id, kind FROM batches WHERE batch_key = $3)) \
         OR batch_key = $3",
    )
    .bind(place.route_key)
    .bind(&place.trip_id)
    .bind(place.batch_key)
    .fetch_all(transaction)
    .await?;
    let mut members = Members::new();
    for row in &rows {
        let member = Member {
            batch_key: row.try_get("batch_key")?,
            vehicle_id: name(row, "vehicle_id")?,
            trip_id: name(row, "trip_id")?,
        };
        members.insert(name(row, "id")?, member);
    }
    Ok(members)
}
