//! Another try for an upload that was kept out of the map.

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;

use super::ApiState;
use super::batches::{BatchBody, known_batch};
use super::extract::{ApiPath, NoQuery};
use super::parameters::{BatchParam, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RetryProblems;
use crate::ids::{BatchId, RouteId};
use crate::model::Actor;
use crate::store::Retried;

/// Try a batch again.
///
/// Of one that is `quarantined` or `unanchored`: after what kept it out was mended, such as a setting,
/// or the trip of a stranger that had its name.
#[utoipa::path(
    post, path = "/v1/routes/{route}/batches/{batch}/retry", tag = "batches",
    params(RouteParam, BatchParam),
    responses((status = 202, description = "It is queued", body = BatchBody), RetryProblems)
)]
pub(super) async fn retry_batch(
    State(state): State<ApiState>,
    ApiPath((route, batch)): ApiPath<(RouteId, BatchId)>,
    _: NoQuery,
    by: Actor,
) -> Result<Response, Problem> {
    let retried = state
        .store
        .retry_batch(&route, &batch, &by, Timestamp::now());
    if let Retried::Refused(reason) = retried.await? {
        let detail = format!("batch {batch} cannot be tried again: {reason}");
        return Err(Problem::new(ProblemKind::RetryRefused, detail));
    }
    // A batch that is not there is the problem of reading it.
    let batch = known_batch(&state, &route, &batch).await?;
    Ok((StatusCode::ACCEPTED, batch).into_response())
}
