//! What handlers extract from a request. Every rejection is a [`Problem`].

use axum::extract::path::ErrorKind;
use axum::extract::rejection::{PathRejection, RawPathParamsRejection};
use axum::extract::{FromRequestParts, Path, Query, RawPathParams};
use axum::http::request::Parts;
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::problem::{Problem, ProblemKind};

/// The parts of the path, as typed ids.
pub(super) struct ApiPath<T>(pub T);

impl<T, S> FromRequestParts<S> for ApiPath<T>
where
    T: DeserializeOwned + Send,
    S: Send + Sync,
{
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let rejection = match Path::<T>::from_request_parts(parts, state).await {
            Ok(Path(value)) => return Ok(Self(value)),
            Err(rejection) => rejection,
        };
        let detail = match &rejection {
            PathRejection::FailedToDeserializePathParams(error) => match error.kind() {
                ErrorKind::WrongNumberOfParameters { .. } | ErrorKind::UnsupportedType { .. } => {
                    return Err(Problem::internal(rejection));
                }
                ErrorKind::DeserializeError { message, .. } => message.clone(),
                ErrorKind::Message(message) => message.clone(),
                other => other.to_string(),
            },
            _ => return Err(Problem::internal(rejection)),
        };
        let detail = format!("a part of the path is not usable: {detail}");
        Err(Problem::new(ProblemKind::InvalidField, detail))
    }
}

/// The decoded parts of the path.
///
/// # Errors
/// 400 for a part that is not UTF-8.
pub(super) async fn raw_path<S: Send + Sync>(
    parts: &mut Parts,
    state: &S,
) -> Result<RawPathParams, Problem> {
    let params = RawPathParams::from_request_parts(parts, state).await;
    params.map_err(|rejection| match rejection {
        RawPathParamsRejection::InvalidUtf8InPathParam(_) => {
            let detail = "a part of the path is not usable: it is not UTF-8";
            Problem::new(ProblemKind::InvalidField, detail)
        }
        other => Problem::internal(other),
    })
}

/// The query's parameters: unknown and repeated ones are refused.
pub(super) struct ApiQuery<T>(pub T);

impl<T, S> FromRequestParts<S> for ApiQuery<T>
where
    T: DeserializeOwned,
    S: Send + Sync,
{
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        match Query::<T>::from_request_parts(parts, state).await {
            Ok(Query(value)) => Ok(Self(value)),
            Err(rejection) => {
                let detail = std::error::Error::source(&rejection)
                    .map_or_else(|| rejection.to_string(), ToString::to_string);
                Err(Problem::new(ProblemKind::InvalidParameter, detail))
            }
        }
    }
}

/// The query of an operation that takes no parameters.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Nothing {}

/// Refuses every query, for operations without parameters.
pub(super) type NoQuery = ApiQuery<Nothing>;
