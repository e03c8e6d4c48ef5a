//! Trying an upload that was kept out of the map again.

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;

use super::ApiState;
use super::batch_body::BatchBody;
use super::batches::known_batch;
use super::extract::{ApiPath, NoQuery};
use super::parameters::{BatchParam, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RetryProblems;
use crate::ids::{BatchId, RouteId};
use crate::model::Actor;
use crate::store::Retried;

/// Try a batch again.
///
/// For a batch that is `quarantined` or `unanchored`, after the cause was removed, such as a setting or another
/// trip with the same name.
#[utoipa::path(
    post, path = "/v1/routes/{route}/batches/{batch}/retry", tag = "batches",
    params(RouteParam, BatchParam),
    responses((status = 202, description = "The batch is queued", body = BatchBody), RetryProblems)
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
    // Reading the batch reports one that does not exist.
    let batch = known_batch(&state, &route, &batch).await?;
    Ok((StatusCode::ACCEPTED, batch).into_response())
}
