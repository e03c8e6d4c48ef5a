//! The layers around every handler: request id, log, metrics, panics, time limit, draining.

use std::any::Any;
use std::time::Instant;

use axum::body::HttpBody;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tracing::Instrument;
use uuid::Uuid;

use super::ApiState;
use super::problem::{Problem, ProblemKind};

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const REQUEST_ID_LENGTH_MAX: usize = 128;
/// Many times longer than the longest sensible query.
const URI_LENGTH_MAX: usize = 8 << 10;

/// The outermost layer: gives the request its id and span, writes problems, and records metrics.
pub(super) async fn observe(request: Request, next: Next) -> Response {
    let started = Instant::now();
    let request_id = request_id(request.headers());
    let path = matched_path(&request);
    let method = known_method(request.method());
    let span = tracing::info_span!("request", id = %request_id, method, path = %path);
    let answer = async {
        let response = next.run(request).await;
        let response = write_problem(response, &request_id);
        let status = response.status().as_u16();
        let elapsed = started.elapsed();
        tracing::debug!(status, elapsed_us = elapsed.as_micros() as u64, "answered");
        let labels = [("method", method.to_owned()), ("path", path.clone())];
        metrics::histogram!("mapshift_http_request_duration_seconds", &labels).record(elapsed);
        let status = status.to_string();
        metrics::counter!("mapshift_http_requests_total", "method" => method, "path" => path.clone(), "status" => status)
            .increment(1);
        response
    };
    let mut response = answer.instrument(span).await;
    if let Ok(value) = HeaderValue::from_str(&request_id) {
        response.headers_mut().insert(REQUEST_ID, value);
    }
    let nosniff = HeaderValue::from_static("nosniff");
    response
        .headers_mut()
        .insert(header::X_CONTENT_TYPE_OPTIONS, nosniff);
    response
}

/// Refuses requests that arrive after the service has begun to stop.
pub(super) async fn refuse_while_draining(
    State(state): State<ApiState>,
    request: Request,
    next: Next,
) -> Response {
    let health = ["/livez", "/metrics"].contains(&request.uri().path());
    if state.draining.is_cancelled() && !health {
        let problem = Problem::new(
            ProblemKind::ShuttingDown,
            "the service is shutting down; send the same again later",
        );
        return problem.closing().into_response();
    }
    next.run(request).await
}

/// Refuses addresses that are too long; the listener bounds the whole head.
pub(super) async fn limit_uri(request: Request, next: Next) -> Response {
    let path = request.uri().path_and_query();
    if path.is_none_or(|path| path.as_str().len() <= URI_LENGTH_MAX) {
        return next.run(request).await;
    }
    let detail = format!("path and query have at most {URI_LENGTH_MAX} bytes");
    let problem = Problem::new(ProblemKind::UriTooLong, detail);
    problem.closing().into_response()
}

/// Ends an answer that takes too long to begin. The time for the request's body, which has limits of its own, is
/// added.
pub(super) async fn limit_time(
    State(state): State<ApiState>,
    request: Request,
    next: Next,
) -> Response {
    let limits = &state.limits;
    let time_max = match request.body().is_end_stream() {
        true => limits.answer_timeout,
        false => limits.answer_timeout + limits.body_pace.total,
    };
    match tokio::time::timeout(time_max, next.run(request)).await {
        Ok(response) => response,
        Err(_) => {
            let detail = "the answer took too long; send the same again later";
            let problem = Problem::new(ProblemKind::Overloaded, detail);
            problem.closing().into_response()
        }
    }
}

/// The problem that a panic in a handler becomes.
pub(super) fn problem_of_panic(panic: Box<dyn Any + Send>) -> Response {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    let text = text.unwrap_or_else(|| "a handler panicked".to_owned());
    Problem::internal(std::io::Error::other(text)).into_response()
}

/// Answers paths that do not exist.
pub(super) async fn unknown_path() -> Problem {
    Problem::new(
        ProblemKind::NotFound,
        "there is no such path: /openapi.json lists them",
    )
}

/// Answers methods that a path does not have, and `OPTIONS`, which asks for those that it has; the router adds
/// `Allow`. There are no CORS headers, because pages of other origins are not admitted.
pub(super) async fn unknown_method(method: Method) -> Response {
    if method == Method::OPTIONS {
        return StatusCode::NO_CONTENT.into_response();
    }
    let detail = "this path has other methods: see Allow";
    Problem::new(ProblemKind::MethodNotAllowed, detail).into_response()
}

fn request_id(headers: &HeaderMap) -> String {
    let plain = |c: u8| c.is_ascii_alphanumeric() || b"-._~:/+=".contains(&c);
    let given = headers.get(REQUEST_ID).and_then(|v| v.to_str().ok());
    let usable =
        |id: &&str| (1..=REQUEST_ID_LENGTH_MAX).contains(&id.len()) && id.bytes().all(plain);
    match given.filter(usable) {
        Some(id) => id.to_owned(),
        None => Uuid::now_v7().to_string(),
    }
}

fn matched_path(request: &Request) -> String {
    let matched = request.extensions().get::<MatchedPath>();
    matched.map_or("unmatched", |path| path.as_str()).to_owned()
}

/// The label of a method. Clients may send any method, which must not create new labels.
fn known_method(method: &Method) -> &'static str {
    match *method {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::PUT => "PUT",
        Method::PATCH => "PATCH",
        Method::POST => "POST",
        Method::DELETE => "DELETE",
        Method::OPTIONS => "OPTIONS",
        _ => "other",
    }
}

/// Writes the body of a problem, and turns plain errors of libraries into problems.
fn write_problem(response: Response, request_id: &str) -> Response {
    let (mut parts, body) = response.into_parts();
    let problem = match parts.extensions.remove::<Problem>() {
        Some(problem) => problem,
        None if parts.status.is_client_error() || parts.status.is_server_error() => {
            Problem::from_status(parts.status)
        }
        None => return Response::from_parts(parts, body),
    };
    if let Some(cause) = problem.cause() {
        tracing::error!(cause = %chain(cause), "a request failed");
    } else {
        tracing::debug!(problem = problem.kind().name(), "refused");
    }
    parts.status = problem.kind().status();
    let body = serde_json::to_vec(&problem.body(request_id)).unwrap_or_default();
    let media_type = HeaderValue::from_static("application/problem+json");
    parts.headers.insert(header::CONTENT_TYPE, media_type);
    parts.headers.remove(header::CONTENT_LENGTH);
    Response::from_parts(parts, body.into())
}

fn chain(error: &(dyn std::error::Error + Send + Sync)) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(error) = source {
        text.push_str(": ");
        text.push_str(&error.to_string());
        source = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use axum::Router;
    use axum::body::{Body, to_bytes};
    use axum::middleware::from_fn;
    use axum::routing::get;
    use tower::ServiceExt;
    use tower_http::catch_panic::CatchPanicLayer;

    use super::*;

    async fn answer(handler: fn() -> StatusCode) -> (StatusCode, serde_json::Value) {
        let router = Router::new()
            .route("/", get(move || async move { handler() }))
            .layer(CatchPanicLayer::custom(problem_of_panic))
            .layer(from_fn(observe));
        let request = Request::builder()
            .header("x-request-id", "r-1")
            .body(Body::empty());
        let response = router.oneshot(request.unwrap()).await.unwrap();
        let status = response.status();
        let body = to_bytes(response.into_body(), 10_000).await.unwrap();
        (status, serde_json::from_slice(&body).unwrap())
    }

    #[tokio::test]
    async fn a_panic_becomes_a_problem_without_its_message() {
        let (status, problem) = answer(|| panic!("the secret")).await;
        assert_eq!(status, StatusCode::INTERNAL_SERVER_ERROR);
        assert_eq!(problem["type"], "/problems/internal");
        assert_eq!(problem["instance"], "r-1");
        assert!(!problem.to_string().contains("secret"));
    }

    #[tokio::test]
    async fn plain_refusals_of_libraries_become_problems() {
        let (status, problem) = answer(|| StatusCode::PAYLOAD_TOO_LARGE).await;
        assert_eq!(status, StatusCode::PAYLOAD_TOO_LARGE);
        assert_eq!(problem["type"], "/problems/too-large");
        let (status, problem) = answer(|| StatusCode::IM_A_TEAPOT).await;
        assert_eq!(status, StatusCode::BAD_REQUEST);
        assert_eq!(problem["status"], 400);
    }
}
