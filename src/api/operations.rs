//! For those who run the service: liveness, readiness, metrics.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::ApiState;
use super::extract::NoQuery;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{AnyProblems, ReadinessProblems};
use crate::ids::RouteId;
use crate::store::StoreError;

/// Say that the process lives.
///
/// Answers as long as requests are served at all, also while the service is draining.
#[utoipa::path(
    get, path = "/livez", tag = "operations",
    responses((status = 200, description = "`ok`", body = String, content_type = "text/plain"), AnyProblems)
)]
pub(super) async fn livez(_: NoQuery) -> &'static str {
    "ok\n"
}

/// Say whether uploads can be taken.
///
/// 503 while the store does not take writes or the service is shutting down.
#[utoipa::path(
    get, path = "/readyz", tag = "operations",
    responses((status = 200, description = "`ok`", body = String, content_type = "text/plain"), ReadinessProblems)
)]
pub(super) async fn readyz(
    State(state): State<ApiState>,
    _: NoQuery,
) -> Result<&'static str, Problem> {
    match state.store.check_ready().await {
        Ok(()) => Ok("ok\n"),
        Err(error) => {
            tracing::warn!(%error, "not ready");
            let detail = match error {
                StoreError::Full => {
                    "the disk is full: uploads are refused, reads and deletions go on"
                }
                _ => "the store does not take writes; the service's log says why",
            };
            Err(Problem::new(ProblemKind::NotReady, detail))
        }
    }
}

/// Read the service's metrics.
///
/// In the text format of Prometheus.
#[utoipa::path(
    get, path = "/metrics", tag = "operations",
    responses((status = 200, description = "Metrics", body = String, content_type = "text/plain"), AnyProblems)
)]
pub(super) async fn metrics(State(state): State<ApiState>, _: NoQuery) -> Response {
    match pending_batches(&state).await {
        Ok(pending) => metrics::gauge!("mapshift_pending_batches").set(pending as f64),
        Err(problem) => tracing::warn!(?problem, "pending batches were not counted"),
    }
    let media_type = "text/plain; version=0.0.4; charset=utf-8";
    ([(header::CONTENT_TYPE, media_type)], state.metrics.render()).into_response()
}

async fn pending_batches(state: &ApiState) -> Result<i64, Problem> {
    const PAGE: u32 = 1_000;
    let (mut pending, mut after): (i64, Option<RouteId>) = (0, None);
    loop {
        let routes = state.store.routes(after.as_ref(), PAGE).await?;
        pending += routes
            .iter()
            .map(|route| route.pending_batches)
            .sum::<i64>();
        match routes.last() {
            Some(last) if routes.len() == PAGE as usize => after = Some(last.id.clone()),
            _ => return Ok(pending),
        }
    }
}
