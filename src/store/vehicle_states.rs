//! Whether what a vehicle sends is believed: determined anew by whatever may change it, and compared with
//! what it was.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::columns::value_of;
use super::error::StoreError;
use super::notices::Notice;
use super::vehicles::{VehicleRecord, kept_out, suspected_by};
use crate::ids::VehicleId;
use crate::model::{VehicleState, WebhookTopic};

impl VehicleRecord {
    /// Whether what it sends is believed.
    pub fn state(&self) -> VehicleState {
        let is_suspect = !self.suspected_by.is_empty() || self.kept_out.is_some();
        state(self.quarantine.is_some(), is_suspect)
    }
}

fn state(is_quarantined: bool, is_suspect: bool) -> VehicleState {
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
        "SELECT EXISTS (SELECT 1 FROM vehicle_quarantines WHERE route_key = $1 AND vehicle_id = $2)",
    )
    .bind(route_key)
    .bind(vehicle.as_str())
    .fetch_one(&mut *transaction)
    .await?;
    let is_suspect = !suspected_by(transaction, route_key, vehicle)
        .await?
        .is_empty()
        || kept_out(transaction, route_key, vehicle).await?.is_some();
    Ok(state(is_quarantined, is_suspect))
}
