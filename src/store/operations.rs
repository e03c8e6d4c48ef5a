//! Long work that somebody asked for: noted, found again after a restart, ended.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::audit::{self, Change};
use super::columns::{
    corrupt, json, json_text, micros, optional_json, optional_name, optional_time, text, time,
};
use super::error::StoreError;
use super::notices::operation_ended;
use super::operation_records::{OperationRecord, OperationRequest, OperationResult};
use super::query::Query;
use super::removal_records::{Meant, RemovalRequest, RemovalResult};
use super::request::Request;
use crate::ids::{OperationId, RouteId};
use crate::model::{Actor, AuditAction, OperationKind, OperationStatus};

impl Store {
    /// Notes what somebody asked for, of one route or (`None`) of several; it is carried out after what
    /// was asked for before.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`].
    pub async fn ask_for(
        &self,
        id: OperationId,
        route: Option<&RouteId>,
        request: OperationRequest,
        by: &Actor,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let ask = Ask {
            id,
            route: route.cloned(),
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
        self.read(OneOperation(id)).await
    }

    /// The operation of a kind whose turn it is.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn next_operation(
        &self,
        kind: OperationKind,
    ) -> Result<Option<OperationRecord>, StoreError> {
        self.read(NextOperation(kind)).await
    }

    /// Notes that a removal begins to make a map anew; returns how often it has begun.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn begin_rebuilding(&self, id: OperationId) -> Result<i64, StoreError> {
        self.work(BeginRebuilding(id)).await
    }

    /// Ends an operation: with a result, or the reason why there is none. A removal that takes something
    /// out ends in [`Store::apply_removal`].
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn end_operation(
        &self,
        id: OperationId,
        outcome: Result<OperationResult, String>,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        self.work(End { id, outcome, now }).await
    }
}

macro_rules! select_operations {
    ($rest:literal) => {
        concat!(
            "SELECT operations.id, operations.kind, routes.id AS route_id, request, status, \
             removed, result, reason, asked_at_us, ended_at_us \
             FROM operations LEFT JOIN routes USING (route_key) ",
            $rest
        )
    };
}

/// One operation.
struct OneOperation(OperationId);

impl Query for OneOperation {
    type Answer = Option<OperationRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_operations!("WHERE operations.id = $1"))
            .bind(self.0.to_string())
            .fetch_optional(reader)
            .await?;
        row.as_ref().map(operation_of).transpose()
    }
}

/// The oldest operation of a kind that has not ended.
struct NextOperation(OperationKind);

impl Query for NextOperation {
    type Answer = Option<OperationRecord>;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let row = sqlx::query(select_operations!(
            "WHERE ended_at_us IS NULL AND operations.kind = $1 ORDER BY operation_key LIMIT 1"
        ))
        .bind(self.0.name())
        .fetch_optional(reader)
        .await?;
        row.as_ref().map(operation_of).transpose()
    }
}

struct Ask {
    id: OperationId,
    route: Option<RouteId>,
    request: OperationRequest,
    by: Actor,
    now: Timestamp,
}

impl Request for Ask {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let inserted = sqlx::query(
            "INSERT INTO operations (id, kind, route_key, request, status, asked_at_us) \
             SELECT $1, $2, (SELECT route_key FROM routes WHERE id = $6), $3, $4, $5 \
             WHERE $6 IS NULL OR EXISTS (SELECT 1 FROM routes WHERE id = $6)",
        )
        .bind(self.id.to_string())
        .bind(self.request.kind().name())
        .bind(match &self.request {
            OperationRequest::Removal(request) => json_text(request)?,
            OperationRequest::Decisions(request) => json_text(request)?,
        })
        .bind(OperationStatus::Queued.name())
        .bind(micros(self.now))
        .bind(self.route.as_ref().map(RouteId::as_str))
        .execute(&mut *transaction)
        .await?;
        if inserted.rows_affected() == 0 {
            return Err(StoreError::UnknownRoute);
        }
        self.note(transaction).await
    }
}

impl Ask {
    /// Writes the audit's row of a removal; a dry run changes nothing, and decisions have rows of their
    /// own once they are carried out.
    async fn note(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        #[derive(Serialize)]
        struct Asked<'a> {
            #[serde(flatten)]
            meant: &'a Meant,
            erase: bool,
            note: Option<&'a str>,
        }
        let OperationRequest::Removal(RemovalRequest {
            meant,
            dry_run: false,
            erase,
            note,
        }) = &self.request
        else {
            return Ok(());
        };
        let asked = Asked {
            meant,
            erase: *erase,
            note: note.as_deref(),
        };
        let change = Change {
            at: self.now,
            actor: &self.by,
            action: AuditAction::RemovalAsked,
            route_id: self.route.as_ref().map(RouteId::as_str),
            subject: &self.id.to_string(),
            before: None,
            after: Some(json_text(&asked)?),
        };
        audit::write(transaction, change).await
    }
}

struct BeginRebuilding(OperationId);

impl Request for BeginRebuilding {
    type Outcome = i64;
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<i64, StoreError> {
        let begun = sqlx::query_scalar(
            "UPDATE operations SET rebuilds_begun = rebuilds_begun + 1 WHERE id = $1 \
             RETURNING rebuilds_begun",
        )
        .bind(self.0.to_string())
        .fetch_optional(transaction)
        .await?;
        Ok(begun.unwrap_or_default())
    }
}

struct End {
    id: OperationId,
    outcome: Result<OperationResult, String>,
    now: Timestamp,
}

impl Request for End {
    type Outcome = ();
    const QUEUES_JOBS: bool = false;
    const WHILE_FULL: bool = true;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        end(transaction, self.id, &self.outcome, self.now).await?;
        Ok(())
    }
}

/// Ends an operation within the transaction that carries it out; false if it has ended already.
pub(super) async fn end(
    transaction: &mut SqliteConnection,
    id: OperationId,
    outcome: &Result<OperationResult, String>,
    now: Timestamp,
) -> Result<bool, StoreError> {
    let status = match outcome {
        Ok(_) => OperationStatus::Succeeded,
        Err(_) => OperationStatus::Failed,
    };
    let result = outcome.as_ref().ok().map(result_text).transpose()?;
    let ended = sqlx::query(
        "UPDATE operations SET status = $1, result = $2, removed = NULL, reason = $3, ended_at_us = $4 \
         WHERE id = $5 AND ended_at_us IS NULL RETURNING kind, request, route_key, \
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
    operation_ended(transaction, id, row.try_get("route_key")?, now).await?;
    let request = request_of(&row)?;
    if request.kind() == OperationKind::Removal && !request.is_dry_run() {
        note_end(transaction, id, row.try_get("route_id")?, outcome, now).await?;
    }
    Ok(true)
}

/// Notes what a removal has removed, before the map is made anew; false if it has ended already.
pub(super) async fn note_removed(
    transaction: &mut SqliteConnection,
    id: OperationId,
    removed: &RemovalResult,
) -> Result<bool, StoreError> {
    let noted =
        sqlx::query("UPDATE operations SET removed = $1 WHERE id = $2 AND ended_at_us IS NULL")
            .bind(json_text(removed)?)
            .bind(id.to_string())
            .execute(transaction)
            .await?;
    Ok(noted.rows_affected() > 0)
}

/// Writes the audit's row of a removal that was carried out, or could not be.
async fn note_end(
    transaction: &mut SqliteConnection,
    id: OperationId,
    route_id: &str,
    outcome: &Result<OperationResult, String>,
    at: Timestamp,
) -> Result<(), StoreError> {
    #[derive(Serialize)]
    struct Failure<'a> {
        reason: &'a str,
    }
    let (action, after) = match outcome {
        Ok(result) => (AuditAction::RemovalDone, result_text(result)?),
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

fn result_text(result: &OperationResult) -> Result<String, StoreError> {
    match result {
        OperationResult::Removal(result) => json_text(result),
        OperationResult::Decisions(outcomes) => json_text(outcomes),
    }
}

fn request_of(row: &SqliteRow) -> Result<OperationRequest, StoreError> {
    Ok(match text(row, "kind")? {
        OperationKind::Removal => OperationRequest::Removal(json(row, "request")?),
        OperationKind::Decisions => OperationRequest::Decisions(json(row, "request")?),
    })
}

fn operation_of(row: &SqliteRow) -> Result<OperationRecord, StoreError> {
    let id: String = row.try_get("id")?;
    let request = request_of(row)?;
    let result = match request.kind() {
        OperationKind::Removal => optional_json(row, "result")?.map(OperationResult::Removal),
        OperationKind::Decisions => optional_json(row, "result")?.map(OperationResult::Decisions),
    };
    Ok(OperationRecord {
        id: id.parse().map_err(|_| corrupt("id"))?,
        route_id: optional_name(row, "route_id")?,
        request,
        status: text(row, "status")?,
        removed: optional_json(row, "removed")?,
        result,
        reason: row.try_get("reason")?,
        asked_at: time(row, "asked_at_us")?,
        ended_at: optional_time(row, "ended_at_us")?,
    })
}
