//! For operators: liveness, readiness, metrics.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::ApiState;
use super::extract::NoQuery;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{AnyProblems, ReadinessProblems};
use crate::store::StoreError;

/// Check that the process is alive.
///
/// Answers as long as requests are served at all, even while the service is shutting down.
#[utoipa::path(
    get, path = "/livez", tag = "operations",
    responses((status = 200, description = "`ok`", body = String, content_type = "text/plain"), AnyProblems)
)]
pub(super) async fn livez(_: NoQuery) -> &'static str {
    "ok\n"
}

/// Check whether uploads can be accepted.
///
/// 503 while the store does not accept writes, or the service is shutting down.
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
                    "the disk is full: uploads are refused, reads and deletions still work"
                }
                _ => "the store does not accept writes; the service's log says why",
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
    match state.store.pending_batches().await {
        Ok(pending) => metrics::gauge!("mapshift_pending_batches").set(pending as f64),
        Err(error) => tracing::warn!(%error, "pending batches could not be counted"),
    }
    let media_type = "text/plain; version=0.0.4; charset=utf-8";
    ([(header::CONTENT_TYPE, media_type)], state.metrics.render()).into_response()
}
