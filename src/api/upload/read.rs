//! Reading a body within bounds of size and time.

use std::time::Duration;

use axum::body::Body;
use futures::StreamExt;

use super::head::too_large;
use crate::api::problem::{Problem, ProblemKind};

/// Reads a body to its end.
///
/// # Errors
/// 413 as soon as it is longer than `bytes_max`, 408 after `time_max`, 400 if it breaks off. All
/// close the connection, because the rest of the body is still on its way.
pub(super) async fn read_body(
    body: Body,
    bytes_max: usize,
    time_max: Duration,
) -> Result<Vec<u8>, Problem> {
    let reading = async {
        let mut bytes = Vec::new();
        let mut chunks = body.into_data_stream();
        while let Some(chunk) = chunks.next().await {
            let chunk = chunk.map_err(|_| {
                Problem::new(ProblemKind::BadRequest, "the body broke off before its end")
            })?;
            if bytes.len() + chunk.len() > bytes_max {
                return Err(too_large(bytes_max));
            }
            bytes.extend_from_slice(&chunk);
        }
        Ok(bytes)
    };
    match tokio::time::timeout(time_max, reading).await {
        Ok(outcome) => outcome.map_err(Problem::closing),
        Err(_) => {
            let detail = format!(
                "the body did not arrive within {} s",
                time_max.as_secs_f64()
            );
            Err(Problem::new(ProblemKind::BodyTimeout, detail).closing())
        }
    }
}
