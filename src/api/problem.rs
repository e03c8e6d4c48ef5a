//! The one error type of the HTTP interface: RFC 9457 problem details.

use std::error::Error;
use std::sync::Arc;

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

pub use super::problem_kinds::ProblemKind;
use crate::ingest::batch_json::{BatchBodyError, BatchProblem};
use crate::ingest::json::{JsonError, JsonMistake};
use crate::store::StoreError;

/// One faulty place in a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct FieldError {
    /// JSON pointer (RFC 6901) to the faulty field of the body, or the name of the parameter.
    #[schema(example = "/lidar/angle_increment")]
    pub pointer: String,
    /// What is wrong and what to send instead.
    #[schema(example = "angle_increment 0.5: did you send degrees?")]
    pub detail: String,
}

/// Problem details (RFC 9457).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = Problem)]
pub struct ProblemBody {
    /// The stable kind of the problem: a URI reference, relative to the service, to a page that explains it.
    #[serde(rename = "type")]
    #[schema(example = "/problems/scan-geometry", format = "uri-reference")]
    pub kind: String,
    /// The kind in words.
    pub title: String,
    /// The HTTP status.
    #[schema(example = 422)]
    pub status: u16,
    /// What happened in this case.
    pub detail: String,
    /// The request's id, as in `X-Request-Id`.
    pub instance: String,
    /// The faulty places, if they can be named.
    pub errors: Vec<FieldError>,
}

/// Why a request was not served.
///
/// As a response it carries itself in the extensions: only the outermost layer knows the id of the request, so
/// that layer writes the body and logs the cause.
#[derive(Debug, Clone)]
pub struct Problem {
    kind: ProblemKind,
    detail: String,
    errors: Vec<FieldError>,
    headers: Vec<(header::HeaderName, HeaderValue)>,
    cause: Option<Arc<dyn Error + Send + Sync>>,
}

impl Problem {
    /// A problem of a kind, with what happened in this case.
    pub fn new(kind: ProblemKind, detail: impl Into<String>) -> Self {
        let problem = Self {
            kind,
            detail: detail.into(),
            errors: Vec::new(),
            headers: Vec::new(),
            cause: None,
        };
        match kind {
            ProblemKind::Overloaded | ProblemKind::ShuttingDown => problem.retry_after(2),
            ProblemKind::NotReady => problem.retry_after(5),
            ProblemKind::DiskFull => problem.retry_after(30),
            _ => problem,
        }
    }

    /// Adds a faulty place.
    pub fn at(mut self, pointer: impl Into<String>) -> Self {
        self.errors.push(FieldError {
            pointer: pointer.into(),
            detail: self.detail.clone(),
        });
        self
    }

    /// The problem of a part of a body, whose JSON pointer within the whole is prepended to those of the faulty
    /// places.
    pub(super) fn below(mut self, pointer: &str) -> Self {
        for error in &mut self.errors {
            error.pointer.insert_str(0, pointer);
        }
        self
    }

    /// Adds a header to the response.
    pub fn header(self, name: header::HeaderName, value: &'static str) -> Self {
        self.with_value(name, HeaderValue::from_static(value))
    }

    /// Adds a header with a computed value.
    pub(super) fn with_value(mut self, name: header::HeaderName, value: HeaderValue) -> Self {
        self.headers.push((name, value));
        self
    }

    /// Closes the connection after the response, because the request's body was not read to its end.
    pub fn closing(self) -> Self {
        self.header(header::CONNECTION, "close")
    }

    /// A failure of the service; the cause goes to the log, not to the client.
    pub fn internal(cause: impl Error + Send + Sync + 'static) -> Self {
        let mut problem = Self::new(
            ProblemKind::Internal,
            "the cause is in the service's log under this request id",
        );
        problem.cause = Some(Arc::new(cause));
        problem
    }

    /// A missing resource below a route.
    pub fn not_found(what: &str) -> Self {
        Self::new(
            ProblemKind::NotFound,
            format!("there is no such {what} on this route"),
        )
    }

    /// A route that does not exist.
    pub fn unknown_route() -> Self {
        Self::new(
            ProblemKind::UnknownRoute,
            "there is no such route: PUT /v1/routes/{route} creates one",
        )
    }

    /// A query parameter that is not usable.
    pub fn parameter(name: &str, detail: impl Into<String>) -> Self {
        Self::new(ProblemKind::InvalidParameter, detail).at(name)
    }

    /// The problem for a plain response of a library.
    pub fn from_status(status: StatusCode) -> Self {
        let kind = match status {
            StatusCode::NOT_FOUND => ProblemKind::NotFound,
            StatusCode::METHOD_NOT_ALLOWED => ProblemKind::MethodNotAllowed,
            StatusCode::REQUEST_TIMEOUT => ProblemKind::BodyTimeout,
            StatusCode::PAYLOAD_TOO_LARGE => ProblemKind::TooLarge,
            StatusCode::URI_TOO_LONG => ProblemKind::UriTooLong,
            StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE => ProblemKind::HeadersTooLarge,
            StatusCode::UNSUPPORTED_MEDIA_TYPE => ProblemKind::UnsupportedMediaType,
            status if status.is_client_error() => ProblemKind::BadRequest,
            _ => ProblemKind::Internal,
        };
        Self::new(kind, kind.title())
    }

    /// The kind.
    pub fn kind(&self) -> ProblemKind {
        self.kind
    }

    /// What happened in this case.
    pub(super) fn detail(&self) -> &str {
        &self.detail
    }

    /// The cause, which only the log may show.
    pub(super) fn cause(&self) -> Option<&(dyn Error + Send + Sync)> {
        self.cause.as_deref()
    }

    /// The body that the client sees.
    pub(super) fn body(&self, request_id: &str) -> ProblemBody {
        ProblemBody {
            kind: format!("/problems/{}", self.kind.name()),
            title: self.kind.title().to_owned(),
            status: self.kind.status().as_u16(),
            detail: self.detail.clone(),
            instance: request_id.to_owned(),
            errors: self.errors.clone(),
        }
    }

    /// Says when to try again.
    pub(super) fn retry_after(self, seconds: u32) -> Self {
        self.with_value(header::RETRY_AFTER, HeaderValue::from(seconds))
    }

    /// The headers of the response.
    pub(super) fn headers(&self) -> &[(header::HeaderName, HeaderValue)] {
        &self.headers
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = Response::new(Body::empty());
        *response.status_mut() = self.kind.status();
        for (name, value) in &self.headers {
            response.headers_mut().insert(name, value.clone());
        }
        response.extensions_mut().insert(self);
        response
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::UnknownRoute => Self::unknown_route(),
            StoreError::Full => Self::new(
                ProblemKind::DiskFull,
                "the disk is full and nothing was written; send the same again later",
            ),
            StoreError::Unavailable => Self::new(
                ProblemKind::Overloaded,
                "the store is not responding at the moment; send the same again later",
            ),
            StoreError::Corrupt(_) => {
                let mut problem = Self::new(ProblemKind::Corrupt, error.to_string());
                problem.cause = Some(Arc::new(error));
                problem
            }
            _ => Self::internal(error),
        }
    }
}

impl From<BatchBodyError> for Problem {
    fn from(error: BatchBodyError) -> Self {
        let kind = match error.problem {
            BatchProblem::MalformedJson => ProblemKind::MalformedJson,
            BatchProblem::InvalidField => ProblemKind::InvalidField,
            BatchProblem::ScanGeometry => ProblemKind::ScanGeometry,
            BatchProblem::EdgeGraph => ProblemKind::EdgeGraph,
            BatchProblem::OutOfRange => ProblemKind::OutOfRange,
            BatchProblem::TimestampOrder => ProblemKind::TimestampOrder,
            BatchProblem::TooLarge => ProblemKind::TooLarge,
        };
        Self::new(kind, error.detail).at(error.pointer)
    }
}

impl From<JsonError> for Problem {
    fn from(error: JsonError) -> Self {
        let kind = match error.mistake {
            JsonMistake::Malformed => ProblemKind::MalformedJson,
            JsonMistake::Field => ProblemKind::InvalidField,
            JsonMistake::Range => ProblemKind::OutOfRange,
        };
        Self::new(kind, error.detail).at(error.pointer)
    }
}
