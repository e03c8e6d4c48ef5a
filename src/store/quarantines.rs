//! Vehicles whose uploads somebody keeps out of a route's map.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::{Row, SqliteConnection};

use super::audit::{self, Change};
use super::columns::{json_text, micros, time};
use super::error::StoreError;
use super::inputs::{self, Input};
use super::query::Query;
use super::request::Request;
use super::vehicle_states::note_state;
use super::{Store, news};
use crate::ids::{RouteId, VehicleId};
use crate::model::{Actor, AuditAction};

/// Since when a vehicle's uploads are kept out of the map, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Quarantine {
    /// When somebody asked for it.
    pub since: Timestamp,
    /// Why, for people.
    pub note: Option<String>,
}

impl Store {
    /// Whether a vehicle's uploads are kept out of a route's map.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn quarantine(
        &self,
        route: &RouteId,
        vehicle: &VehicleId,
    ) -> Result<Option<Quarantine>, StoreError> {
        self.read(QuarantineOf { route, vehicle }).await
    }

    /// Keeps a vehicle's uploads out of a route's map from now on (`Some`), or no longer. Nothing changes
    /// if that is so already. False if the route has no such vehicle.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn put_quarantine(
        &self,
        route: &RouteId,
        vehicle: &VehicleId,
        quarantine: Option<Quarantine>,
        by: &Actor,
        now: Timestamp,
    ) -> Result<bool, StoreError> {
        let put = PutQuarantine {
            route: route.clone(),
            vehicle: vehicle.clone(),
            quarantine,
            by: by.clone(),
            now,
        };
        Ok(self.work(put).await?.is_some())
    }
}

/// Whether a vehicle's uploads are kept out of a route's map.
pub(super) struct QuarantineOf<'a> {
    pub(super) route: &'a RouteId,
    pub(super) vehicle: &'a VehicleId,
}

impl Query for QuarantineOf<'_> {
    type Answer = Option<Quarantine>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(
            "SELECT since_us, note FROM routes JOIN vehicle_quarantines USING (route_key) \
             WHERE routes.id = $1 AND vehicle_id = $2",
        )
        .bind(self.route.as_str())
        .bind(self.vehicle.as_str())
        .fetch_optional(reader)
        .await?;
        let quarantine = row.map(|row| {
            Ok::<_, StoreError>(Quarantine {
                since: time(&row, "since_us")?,
                note: row.try_get("note")?,
            })
        });
        quarantine.transpose()
    }
}

struct PutQuarantine {
    route: RouteId,
    vehicle: VehicleId,
    quarantine: Option<Quarantine>,
    by: Actor,
    now: Timestamp,
}

impl Request for PutQuarantine {
    /// Whether it changed anything; `None`: there is no such vehicle.
    type Outcome = Option<bool>;
    const QUEUES_JOBS: bool = false;

    async fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<bool>, StoreError> {
        let route_key: Option<i64> = sqlx::query_scalar(
            "SELECT route_key FROM routes JOIN batches USING (route_key) \
             WHERE routes.id = $1 AND vehicle_id = $2 LIMIT 1",
        )
        .bind(self.route.as_str())
        .bind(self.vehicle.as_str())
        .fetch_optional(&mut *transaction)
        .await?;
        let Some(route_key) = route_key else {
            return Ok(None);
        };
        let before = self.present(transaction).await?;
        let written = match &self.quarantine {
            Some(quarantine) => sqlx::query(
                "INSERT INTO vehicle_quarantines (route_key, vehicle_id, since_us, note) \
                 VALUES ($1, $2, $3, $4) ON CONFLICT DO NOTHING",
            )
            .bind(route_key)
            .bind(self.vehicle.as_str())
            .bind(micros(quarantine.since))
            .bind(&quarantine.note),
            None => sqlx::query(
                "DELETE FROM vehicle_quarantines WHERE route_key = $1 AND vehicle_id = $2",
            )
            .bind(route_key)
            .bind(self.vehicle.as_str()),
        };
        written.execute(&mut *transaction).await?;
        self.note(transaction, route_key, before).await.map(Some)
    }

    fn committed(&self, changed: &Option<bool>) {
        if *changed == Some(true) {
            let is_out = self.quarantine.is_some();
            news::vehicle_kept_out(&self.route, &self.vehicle, is_out, &self.by);
        }
    }
}

impl PutQuarantine {
    async fn present(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<Quarantine>, StoreError> {
        let (route, vehicle) = (&self.route, &self.vehicle);
        QuarantineOf { route, vehicle }.answer(transaction).await
    }

    /// Writes the rows of the audit and of the inputs, unless everything is as it was: returns whether
    /// it did.
    async fn note(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
        before: Option<Quarantine>,
    ) -> Result<bool, StoreError> {
        let after = self.present(transaction).await?;
        if before == after {
            return Ok(false);
        }
        let vehicle = self.vehicle.clone();
        let input = match &after {
            Some(quarantine) => Input::VehicleQuarantined {
                vehicle,
                note: quarantine.note.clone(),
            },
            None => Input::VehicleReleased { vehicle },
        };
        inputs::note(transaction, route_key, self.now, &input).await?;
        let change = Change {
            at: self.now,
            actor: &self.by,
            action: match after {
                Some(_) => AuditAction::VehicleQuarantined,
                None => AuditAction::VehicleReleased,
            },
            route_id: Some(self.route.as_str()),
            subject: self.vehicle.as_str(),
            before: before.as_ref().map(json_text).transpose()?,
            after: after.as_ref().map(json_text).transpose()?,
        };
        audit::write(transaction, change).await?;
        note_state(transaction, route_key, &self.vehicle, self.now).await?;
        Ok(true)
    }
}
