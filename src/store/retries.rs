//! Another try for an upload that was kept out of the map.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::audit::{self, Change};
use super::columns::{json_text, name, text};
use super::error::StoreError;
use super::request::Request;
use super::trips::{Place, queue};
use super::vehicle_states::note_state;
use crate::ids::{BatchId, RouteId, VehicleId};
use crate::model::{Actor, AuditAction, BatchKind, BatchStatus};

/// What became of a request to try a batch again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Retried {
    /// It is queued.
    Queued,
    /// There is no such batch.
    NotThere,
    /// It cannot be tried again; the text says why.
    Refused(String),
}

impl Store {
    /// Queues a quarantined or unanchored batch again.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn retry_batch(
        &self,
        route: &RouteId,
        batch: &BatchId,
        by: &Actor,
        now: Timestamp,
    ) -> Result<Retried, StoreError> {
        let request = Retry {
            route: route.clone(),
            batch: batch.clone(),
            by: by.clone(),
            now,
        };
        self.work(request).await
    }
}

struct Retry {
    route: RouteId,
    batch: BatchId,
    by: Actor,
    now: Timestamp,
}

impl Request for Retry {
    type Outcome = Retried;
    const QUEUES_JOBS: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Retried, StoreError> {
        let row = sqlx::query(
            "SELECT batch_key, route_key, batches.vehicle_id, trip_id, sequence, kind, status, \
                 reason, body_kept, trips.vehicle_id AS driver, \
                 EXISTS (SELECT 1 FROM jobs WHERE jobs.batch_key = batches.batch_key) AS has_job, \
                 EXISTS (SELECT 1 FROM batches AS other WHERE other.route_key = batches.route_key \
                     AND other.trip_id = batches.trip_id \
                     AND other.vehicle_id = trips.vehicle_id \
                     AND other.status <> 'removed') AS is_driven, \
                 EXISTS (SELECT 1 FROM batches AS later WHERE later.route_key = batches.route_key \
                     AND later.trip_id = batches.trip_id AND later.sequence >= batches.sequence \
                     AND later.batch_key <> batches.batch_key \
                     AND later.status IN ('merged', 'processing', 'queued')) AS is_overtaken \
             FROM routes JOIN batches USING (route_key) JOIN trips USING (route_key, trip_id) \
             WHERE routes.id = $1 AND batches.id = $2",
        )
        .bind(self.route.as_str())
        .bind(self.batch.as_str())
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(row) = row else {
            return Ok(Retried::NotThere);
        };
        let (status, kind): (BatchStatus, BatchKind) = (text(&row, "status")?, text(&row, "kind")?);
        let (vehicle, driver): (String, String) =
            (row.try_get("vehicle_id")?, row.try_get("driver")?);
        let trip_id: String = row.try_get("trip_id")?;
        let refused = |reason: String| Ok(Retried::Refused(reason));
        if !matches!(status, BatchStatus::Quarantined | BatchStatus::Unanchored) {
            let name = status.name();
            return refused(format!(
                "it is {name}: only what is quarantined or unanchored is tried again"
            ));
        }
        if !row.try_get::<bool, _>("body_kept")? {
            return refused("its bytes are not kept any more: send them under another id".into());
        }
        if vehicle != driver && row.try_get::<bool, _>("is_driven")? {
            return refused(format!(
                "trip {trip_id} belongs to vehicle {driver}: remove that trip first"
            ));
        }
        if kind == BatchKind::Scans && row.try_get::<bool, _>("is_overtaken")? {
            return refused(format!(
                "trip {trip_id} has gone on without it: send its scans as another trip"
            ));
        }
        let place = Place {
            batch_key: row.try_get("batch_key")?,
            route_key: row.try_get("route_key")?,
            trip_id,
            sequence: row.try_get("sequence")?,
        };
        if row.try_get::<bool, _>("has_job")? {
            return Ok(Retried::Queued);
        }
        hand_trip_over(transaction, &place, &vehicle).await?;
        queue(transaction, &place).await?;
        let sender: VehicleId = name(&row, "vehicle_id")?;
        note_state(transaction, place.route_key, &sender, self.now).await?;
        self.note(transaction, status, row.try_get("reason")?)
            .await?;
        Ok(Retried::Queued)
    }
}

impl Retry {
    async fn note(
        &self,
        transaction: &mut SqliteConnection,
        status: BatchStatus,
        reason: Option<&str>,
    ) -> Result<(), StoreError> {
        #[derive(Serialize)]
        struct State<'a> {
            status: BatchStatus,
            reason: Option<&'a str>,
        }
        let queued = State {
            status: BatchStatus::Queued,
            reason,
        };
        let change = Change {
            at: self.now,
            actor: &self.by,
            action: AuditAction::BatchRetried,
            route_id: Some(self.route.as_str()),
            subject: self.batch.as_str(),
            before: Some(json_text(&State { status, reason })?),
            after: Some(json_text(&queued)?),
        };
        audit::write(transaction, change).await
    }
}

/// Makes a trip the vehicle's own; no other vehicle has a batch of it that counts.
async fn hand_trip_over(
    transaction: &mut SqliteConnection,
    place: &Place,
    vehicle: &str,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE trips SET vehicle_id = $1, next_sequence = max(next_sequence, $2) \
         WHERE route_key = $3 AND trip_id = $4",
    )
    .bind(vehicle)
    .bind(place.sequence)
    .bind(place.route_key)
    .bind(&place.trip_id)
    .execute(transaction)
    .await?;
    Ok(())
}
