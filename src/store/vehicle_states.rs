//! Whether what a vehicle sends is trusted: determined anew by every write that may change it, and
//! compared with the state before.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::columns::{alert_id, value_of};
use super::error::StoreError;
use super::notices::Notice;
use super::query::Query;
use crate::ids::{AlertId, VehicleId};
use crate::model::{BatchStatus, VehicleState, WebhookTopic};

/// A vehicle is suspect if at least this many of its newest ten batches were kept out.
const KEPT_OUT_MIN: i64 = 3;

/// Uploads of a vehicle that were kept out of the map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptOut {
    /// How many of the newest ten.
    pub batches: i64,
    /// Why the last of them was.
    pub reason: Option<String>,
}

/// The state of a vehicle; a quarantine comes before what makes it suspect.
pub(super) fn state(is_quarantined: bool, is_suspect: bool) -> VehicleState {
    match (is_quarantined, is_suspect) {
        (true, _) => VehicleState::Quarantined,
        (false, true) => VehicleState::Suspect,
        (false, false) => VehicleState::Trusted,
    }
}

/// Determines a vehicle's state anew, and queues that it has become suspect or quarantined.
pub(super) async fn note_state(
    transaction: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
    at: Timestamp,
) -> Result<(), StoreError> {
    let before = stored(transaction, route_key, vehicle).await?;
    let now = present(transaction, route_key, vehicle).await?;
    if before == now {
        return Ok(());
    }
    sqlx::query(
        "INSERT INTO vehicle_states (route_key, vehicle_id, state) VALUES ($1, $2, $3) \
         ON CONFLICT DO UPDATE SET state = excluded.state",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .bind(now.name())
    .execute(&mut *transaction)
    .await?;
    if now < before {
        return Ok(());
    }
    let notice = Notice {
        topic: WebhookTopic::VehicleSuspect,
        route_key: Some(route_key),
        subject: vehicle.as_str(),
        at,
    };
    notice.queue(transaction).await
}

async fn stored(
    transaction: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<VehicleState, StoreError> {
    let state: Option<String> = sqlx::query_scalar(
        "SELECT state FROM vehicle_states WHERE route_key = $1 AND vehicle_id = $2",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .fetch_optional(transaction)
    .await?;
    let state = state.map(|text| value_of(&text, "state")).transpose()?;
    Ok(state.unwrap_or(VehicleState::Trusted))
}

async fn present(
    transaction: &mut SqliteConnection,
    route_key: i64,
    vehicle: &VehicleId,
) -> Result<VehicleState, StoreError> {
    let is_quarantined = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM vehicle_quarantines \
         WHERE route_key = $1 AND vehicle_id = $2)",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .fetch_one(&mut *transaction)
    .await?;
    let suspected_by = SuspectedBy { route_key, vehicle };
    let kept_out = RecentlyKeptOut { route_key, vehicle };
    let is_suspect = !suspected_by.answer(transaction).await?.is_empty()
        || kept_out.answer(transaction).await?.is_some();
    Ok(state(is_quarantined, is_suspect))
}

/// How many of a vehicle's newest ten batches were kept out of the map, if several were; those that
/// still wait are not counted among the ten.
pub(super) struct RecentlyKeptOut<'a> {
    pub(super) route_key: i64,
    pub(super) vehicle: &'a VehicleId,
}

impl Query for RecentlyKeptOut<'_> {
    type Answer = Option<KeptOut>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows: Vec<(String, Option<String>)> = sqlx::query_as(
            "SELECT status, reason FROM batches \
             WHERE route_key = $1 AND vehicle_id = $2 \
             AND status IN ('merged', 'unanchored', 'quarantined') \
             ORDER BY batch_key DESC LIMIT 10",
        )
        .bind(self.route_key)
        .bind(self.vehicle.as_str())
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
}

/// The undecided alerts that suspect a vehicle.
pub(super) struct SuspectedBy<'a> {
    pub(super) route_key: i64,
    pub(super) vehicle: &'a VehicleId,
}

impl Query for SuspectedBy<'_> {
    type Answer = Vec<AlertId>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let rows = sqlx::query(
            "SELECT alerts.id FROM alerts WHERE route_key = $1 AND kind = 'vehicle_suspect' \
             AND status IN ('open', 'acknowledged') \
             AND EXISTS (SELECT 1 FROM json_each(alerts.vehicles) WHERE value = $2) ORDER BY id",
        )
        .bind(self.route_key)
        .bind(self.vehicle.as_str())
        .fetch_all(reader)
        .await?;
        rows.iter().map(|row| alert_id(row, "id")).collect()
    }
}
