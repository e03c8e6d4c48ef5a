//! Operations: long work that a request has started, and its progress.

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::alerts::DecisionOutcomeBody;
use super::extract::{ApiPath, NoQuery};
use super::parameters::OperationParam;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::OperationProblems;
use crate::ids::OperationId;
use crate::model::{OperationKind, OperationStatus};
use crate::store::{OperationRecord, OperationResult};

/// Long work that a request has started.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Operation)]
pub(super) struct OperationBody {
    /// Its id.
    id: String,
    /// What it does.
    kind: OperationKind,
    /// The route that it changes; null if it concerns alerts of several routes.
    #[schema(required)]
    route_id: Option<String>,
    /// Its status.
    status: OperationStatus,
    /// How much of it is done, from 0 to 1.
    #[schema(minimum = 0, maximum = 1)]
    progress: f64,
    /// Whether it only reports what it would do.
    dry_run: bool,
    /// What was done, or would be done; null until it has succeeded.
    #[schema(required)]
    result: Option<OperationResultBody>,
    /// Why it failed; null otherwise.
    #[schema(required)]
    reason: Option<String>,
    /// When it was requested.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// When it ended; null before.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    ended_at: Option<Timestamp>,
}

/// The result of an operation: a `removal` has all fields except `decisions`, `decisions` only that one; the others
/// are null.
#[derive(Debug, Default, Serialize, ToSchema)]
#[schema(as = OperationResult)]
struct OperationResultBody {
    /// Batches that were removed, or would be.
    #[schema(required)]
    batches: Option<u64>,
    /// Nodes that were removed, or would be.
    #[schema(required)]
    nodes: Option<u64>,
    /// Edges that were removed, or would be, including edges of other batches that ended at these nodes.
    #[schema(required)]
    edges: Option<u64>,
    /// Alerts that change: raised, resolved, or with less evidence.
    #[schema(required)]
    alerts: Option<u64>,
    /// The largest displacement of a node in the rest of the map, metres.
    #[schema(required)]
    moved_m: Option<f64>,
    /// Whether the map was rebuilt as if the removed batches had never been uploaded; false for a dry run, and
    /// where nothing of the map was removed.
    #[schema(required)]
    rebuilt: Option<bool>,
    /// Why the map was not rebuilt; null otherwise. The batches are removed all the same.
    #[schema(required)]
    not_rebuilt_because: Option<String>,
    /// The outcome of each decision, in the order of the request.
    #[schema(required)]
    decisions: Option<Vec<DecisionOutcomeBody>>,
}

impl From<OperationResult> for OperationResultBody {
    fn from(result: OperationResult) -> Self {
        match result {
            OperationResult::Removal(result) => Self {
                batches: Some(result.batches),
                nodes: Some(result.nodes),
                edges: Some(result.edges),
                alerts: Some(result.alerts),
                moved_m: Some(result.moved_m),
                rebuilt: Some(result.rebuilt),
                not_rebuilt_because: result.not_rebuilt_because,
                decisions: None,
            },
            OperationResult::Decisions(outcomes) => {
                let outcomes = outcomes.into_iter().map(DecisionOutcomeBody::from);
                Self {
                    decisions: Some(outcomes.collect()),
                    ..Self::default()
                }
            }
        }
    }
}

impl OperationBody {
    /// `share` is how much is done of one that has not ended.
    pub(super) fn of(operation: OperationRecord, share: f64) -> Self {
        Self {
            id: operation.id.to_string(),
            kind: operation.request.kind(),
            route_id: operation.route_id.map(|route| route.to_string()),
            status: operation.status,
            progress: match operation.status {
                OperationStatus::Queued => share,
                OperationStatus::Succeeded | OperationStatus::Failed => 1.0,
            },
            dry_run: operation.request.is_dry_run(),
            result: operation.result.map(Into::into),
            reason: operation.reason,
            created_at: operation.asked_at,
            ended_at: operation.ended_at,
        }
    }
}

/// Read an operation.
///
/// The progress and the result of long work.
#[utoipa::path(
    get, path = "/v1/operations/{operation}", tag = "batches",
    params(OperationParam),
    responses((status = 200, description = "The operation", body = OperationBody), OperationProblems)
)]
pub(super) async fn get_operation(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<OperationId>,
    _: NoQuery,
) -> Result<Json<OperationBody>, Problem> {
    let operation = known_operation(&state, id).await?;
    let share = state.operations.share_done(id);
    Ok(Json(OperationBody::of(operation, share)))
}

/// The answer 202 that names an operation which has been accepted.
pub(super) async fn accepted(state: &ApiState, id: OperationId) -> Result<Response, Problem> {
    let operation = known_operation(state, id).await?;
    let location = format!("/v1/operations/{id}");
    let body = Json(OperationBody::of(operation, 0.0));
    Ok((StatusCode::ACCEPTED, [(header::LOCATION, location)], body).into_response())
}

/// An operation as it is now.
///
/// # Errors
/// The [`Problem`] that there is none.
pub(super) async fn known_operation(
    state: &ApiState,
    id: OperationId,
) -> Result<OperationRecord, Problem> {
    let operation = state.store.operation(id).await?;
    operation.ok_or_else(unknown_operation)
}

pub(super) fn unknown_operation() -> Problem {
    let detail = "there is no such operation, or its route was deleted";
    Problem::new(ProblemKind::NotFound, detail)
}
