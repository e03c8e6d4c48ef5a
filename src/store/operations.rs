//! Long work that somebody asked for: noted, found again after a restart, ended.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::audit::{self, Change};
use super::columns::{
    corrupt, json, json_text, micros, name, optional_json, optional_time, text, time,
};
use super::error::StoreError;
use super::removal_records::{Meant, OperationRecord, RemovalRequest, RemovalResult};
use super::request::Request;
use super::{Store, named};
use crate::ids::{OperationId, RouteId};
use crate::model::{Actor, AuditAction, OperationStatus};

impl Store {
    /// Notes what somebody asked for; it is carried out after what was asked for before.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`].
    pub async fn ask_for(
        &self,
        id: OperationId,
        route: &RouteId,
        request: RemovalRequest,
        by: &Actor,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let ask = Ask {
            id,
            route: route.clone(),
            request,
            by: by.clone(),
            now,
        };
        self.work(ask).await
    }

    /// One operation.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn operation(&self, id: OperationId) -> Result<Option<OperationRecord>, StoreError> {
        let row = sqlx::query(select_operations!("WHERE operations.id = $1"))
            .bind(id.to_string())
            .fetch_optional(&self.shared.readers)
            .await;
        named(
            row.map_err(StoreError::from)
                .and_then(|row| row.as_ref().map(operation_of).transpose()),
        )
    }

    /// The operation whose turn it is.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn next_operation(&self) -> Result<Option<OperationRecord>, StoreError> {
        let row = sqlx::query(select_operations!(
            "WHERE ended_at_us IS NULL ORDER BY operation_key LIMIT 1"
        ))
        .fetch_optional(&self.shared.readers)
        .await;
        named(
            row.map_err(StoreError::from)
                .and_then(|row| row.as_ref().map(operation_of).transpose()),
        )
    }

    /// Ends an operation that changes nothing: with a result, or the reason why there is none.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn end_operation(
        &self,
        id: OperationId,
        outcome: Result<RemovalResult, String>,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        self.work(End { id, outcome, now }).await
    }
}

macro_rules! select_operations {
    ($rest:literal) => {
        concat!(
            "SELECT operations.id, routes.id AS route_id, request, status, result, reason, \
             asked_at_us, ended_at_us FROM operations JOIN routes USING (route_key) ",
            $rest
        )
    };
}
use select_operations;

struct Ask {
    id: OperationId,
    route: RouteId,
    request: RemovalRequest,
    by: Actor,
    now: Timestamp,
}

impl Request for Ask {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let inserted = sqlx::query(
            "INSERT INTO operations (id, route_key, request, status, asked_at_us) \
             SELECT $1, route_key, $2, $3, $4 FROM routes WHERE id = $5",
        )
        .bind(self.id.to_string())
        .bind(json_text(&self.request)?)
        .bind(OperationStatus::Queued.name())
        .bind(micros(self.now))
        .bind(self.route.as_str())
        .execute(&mut *transaction)
        .await?;
        if inserted.rows_affected() == 0 {
            return Err(StoreError::UnknownRoute);
        }
        self.note(transaction).await
    }
}

impl Ask {
    /// Writes the audit's row; a dry run changes nothing.
    async fn note(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        #[derive(Serialize)]
        struct Asked<'a> {
            #[serde(flatten)]
            meant: &'a Meant,
            erase: bool,
            note: Option<&'a str>,
        }
        let RemovalRequest {
            meant,
            dry_run,
            erase,
            note,
        } = &self.request;
        if *dry_run {
            return Ok(());
        }
        let asked = Asked {
            meant,
            erase: *erase,
            note: note.as_deref(),
        };
        let change = Change {
            at: self.now,
            actor: &self.by,
            action: AuditAction::RemovalAsked,
            route_id: Some(self.route.as_str()),
            subject: &self.id.to_string(),
            before: None,
            after: Some(json_text(&asked)?),
        };
        audit::write(transaction, change).await
    }
}

struct End {
    id: OperationId,
    outcome: Result<RemovalResult, String>,
    now: Timestamp,
}

impl Request for End {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        end(transaction, self.id, &self.outcome, self.now).await?;
        Ok(())
    }
}

/// Ends an operation within the transaction that carries it out; false if it has ended already.
pub(super) async fn end(
    transaction: &mut SqliteConnection,
    id: OperationId,
    outcome: &Result<RemovalResult, String>,
    now: Timestamp,
) -> Result<bool, StoreError> {
    let status = match outcome {
        Ok(_) => OperationStatus::Succeeded,
        Err(_) => OperationStatus::Failed,
    };
    let result = outcome.as_ref().ok().map(json_text).transpose()?;
    let ended = sqlx::query(
        "UPDATE operations SET status = $1, result = $2, reason = $3, ended_at_us = $4 \
         WHERE id = $5 AND ended_at_us IS NULL RETURNING request, \
         (SELECT id FROM routes WHERE routes.route_key = operations.route_key) AS route_id",
    )
    .bind(status.name())
    .bind(result)
    .bind(outcome.as_ref().err())
    .bind(micros(now))
    .bind(id.to_string())
    .fetch_optional(&mut *transaction)
    .await?;
    let Some(row) = ended else { return Ok(false) };
    let request: RemovalRequest = json(&row, "request")?;
    if !request.dry_run {
        note_end(transaction, id, row.try_get("route_id")?, outcome, now).await?;
    }
    Ok(true)
}

/// Writes the audit's row of a removal that was carried out, or could not be.
async fn note_end(
    transaction: &mut SqliteConnection,
    id: OperationId,
    route_id: &str,
    outcome: &Result<RemovalResult, String>,
    at: Timestamp,
) -> Result<(), StoreError> {
    #[derive(Serialize)]
    struct Failure<'a> {
        reason: &'a str,
    }
    let (action, after) = match outcome {
        Ok(result) => (AuditAction::RemovalDone, json_text(result)?),
        Err(reason) => (AuditAction::RemovalFailed, json_text(&Failure { reason })?),
    };
    let change = Change {
        at,
        actor: &Actor::System,
        action,
        route_id: Some(route_id),
        subject: &id.to_string(),
        before: None,
        after: Some(after),
    };
    audit::write(transaction, change).await
}

fn operation_of(row: &SqliteRow) -> Result<OperationRecord, StoreError> {
    let id: String = row.try_get("id")?;
    Ok(OperationRecord {
        id: id.parse().map_err(|_| corrupt("id"))?,
        route_id: name(row, "route_id")?,
        request: json(row, "request")?,
        status: text(row, "status")?,
        result: optional_json(row, "result")?,
        reason: row.try_get("reason")?,
        asked_at: time(row, "asked_at_us")?,
        ended_at: optional_time(row, "ended_at_us")?,
    })
}
