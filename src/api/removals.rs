//! Taking uploads out of a route, and how far that has come.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::note::checked_note;
use super::parameters::{OperationParam, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{OperationProblems, RemovalProblems};
use super::upload::small_json;
use crate::ids::{BatchId, OperationId, RouteId, TripId, VehicleId};
use crate::model::{Actor, OperationStatus};
use crate::store::{Meant, OperationRecord, RemovalRequest, RemovalResult};

const NAMES_MAX: usize = 1_000;

/// What to take out: exactly one of `batches`, `trips` and `vehicle_id`.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"trips": ["agv-07-0931"], "note": "its lidar was loose"}))]
pub(super) struct RemovalPost {
    /// Batches by their ids.
    #[schema(min_items = 1, max_items = 1000, value_type = Option<Vec<String>>)]
    batches: Option<Vec<BatchId>>,
    /// Everything of some trips.
    #[schema(min_items = 1, max_items = 1000, value_type = Option<Vec<String>>)]
    trips: Option<Vec<TripId>>,
    /// Everything that a vehicle sent …
    #[schema(value_type = Option<String>)]
    vehicle_id: Option<VehicleId>,
    /// … and that came in at this time or later; only with `vehicle_id`.
    #[schema(value_type = Option<String>, format = DateTime)]
    since: Option<Timestamp>,
    /// Only say what would be removed; false if left out.
    dry_run: Option<bool>,
    /// Delete the bytes of the uploads too, for good; false if left out.
    erase: Option<bool>,
    /// Why, for people: stands as the `reason` of the batches.
    #[schema(max_length = 2000)]
    note: Option<String>,
}

/// Long work that somebody asked for.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Operation)]
pub(super) struct OperationBody {
    /// By which it is asked for.
    id: String,
    /// The route that it changes.
    route_id: String,
    /// How far it has come.
    status: OperationStatus,
    /// From 0 to 1.
    #[schema(minimum = 0, maximum = 1)]
    progress: f64,
    /// Whether it only says what it would do.
    dry_run: bool,
    /// What was removed, or would be; null until it has succeeded.
    #[schema(required)]
    result: Option<RemovalResultBody>,
    /// Why it failed; null unless it did.
    #[schema(required)]
    reason: Option<String>,
    /// When it was asked for.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// When it ended.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    ended_at: Option<Timestamp>,
}

/// What was removed, or would be.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = RemovalResult)]
struct RemovalResultBody {
    /// Uploads.
    batches: u64,
    /// Nodes.
    nodes: u64,
    /// Edges, those of others that ended at the nodes among them.
    edges: u64,
    /// Alerts that change by it: raised, resolved, or resting on less.
    alerts: u64,
    /// How far the rest of the map moves, at most, metres.
    moved_m: f64,
}

impl From<RemovalResult> for RemovalResultBody {
    fn from(result: RemovalResult) -> Self {
        Self {
            batches: result.batches,
            nodes: result.nodes,
            edges: result.edges,
            alerts: result.alerts,
            moved_m: result.moved_m,
        }
    }
}

impl From<OperationRecord> for OperationBody {
    fn from(operation: OperationRecord) -> Self {
        Self {
            id: operation.id.to_string(),
            route_id: operation.route_id.to_string(),
            status: operation.status,
            progress: match operation.status {
                OperationStatus::Queued => 0.0,
                OperationStatus::Succeeded | OperationStatus::Failed => 1.0,
            },
            dry_run: operation.request.dry_run,
            result: operation.result.map(Into::into),
            reason: operation.reason,
            created_at: operation.asked_at,
            ended_at: operation.ended_at,
        }
    }
}

impl RemovalPost {
    fn check(self) -> Result<RemovalRequest, Problem> {
        let refuse = |pointer: &str, detail: &str| {
            Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer))
        };
        if self.since.is_some() && self.vehicle_id.is_none() {
            return refuse("/since", "a time goes with vehicle_id alone");
        }
        let is_count = |count: usize| (1..=NAMES_MAX).contains(&count);
        if self
            .batches
            .as_ref()
            .is_some_and(|names| !is_count(names.len()))
        {
            return refuse("/batches", "name 1 to 1,000 batches");
        }
        if self
            .trips
            .as_ref()
            .is_some_and(|names| !is_count(names.len()))
        {
            return refuse("/trips", "name 1 to 1,000 trips");
        }
        let meant = match (self.batches, self.trips, self.vehicle_id) {
            (Some(batches), None, None) => Meant::Batches(batches),
            (None, Some(trips), None) => Meant::Trips(trips),
            (None, None, Some(id)) => Meant::Vehicle {
                id,
                since: self.since,
            },
            _ => return refuse("", "give exactly one of batches, trips and vehicle_id"),
        };
        Ok(RemovalRequest {
            meant,
            dry_run: self.dry_run.unwrap_or(false),
            erase: self.erase.unwrap_or(false),
            note: checked_note(self.note)?,
        })
    }
}

/// Take uploads out of a route.
///
/// Out of the map, of alerts and of pictures: their nodes and edges go, the rest of the map is solved
/// anew, and every place is judged anew. The uploads stay in the list of batches as `removed`, and their
/// bytes are kept unless `erase` says otherwise. What nothing ties to the rest any more stays where it
/// is. Safe to repeat: what was removed before is passed over. The answer names an operation, which says
/// how far it has come; it goes on if the service is restarted meanwhile.
#[utoipa::path(
    post, path = "/v1/routes/{route}/removals", tag = "batches",
    params(RouteParam),
    request_body(content = RemovalPost, description = "What to take out"),
    responses(
        (status = 202, description = "It will be carried out", body = OperationBody, headers(("Location" = String, description = "The operation"))),
        RemovalProblems,
    )
)]
pub(super) async fn post_removal(
    State(state): State<ApiState>,
    ApiPath(route): ApiPath<RouteId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let post: RemovalPost = small_json(&state, &headers, body).await?;
    let id = state.removals.ask_for(&route, post.check()?, &by).await?;
    let operation = known_operation(&state, id).await?;
    let location = format!("/v1/operations/{id}");
    let body = Json(OperationBody::from(operation));
    Ok((StatusCode::ACCEPTED, [(header::LOCATION, location)], body).into_response())
}

/// Read an operation.
///
/// How far long work has come, and what came of it.
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
    Ok(Json(operation.into()))
}

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
