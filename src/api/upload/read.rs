//! Reading a body within bounds of size, pace and time.

use std::time::Instant;

use axum::body::Body;
use futures::StreamExt;
use tokio::time::timeout_at;

use super::head::too_large;
use crate::api::limits::Pace;
use crate::api::problem::{Problem, ProblemKind};

/// Reads a body to its end.
///
/// # Errors
/// 413 as soon as it is longer than `bytes_max`, 408 as soon as it falls behind the pace, 400 if it
/// breaks off. All close the connection, because the rest of the body is still on its way.
pub(super) async fn read_body(
    body: Body,
    bytes_max: usize,
    pace: Pace,
) -> Result<Vec<u8>, Problem> {
    let begun = Instant::now();
    let mut bytes = Vec::new();
    let mut chunks = body.into_data_stream();
    loop {
        let deadline = pace.deadline(begun, bytes.len() as u64);
        let chunk = timeout_at(deadline.into(), chunks.next()).await;
        let Some(chunk) = chunk.map_err(|_| too_slow(pace).closing())? else {
            return Ok(bytes);
        };
        let chunk = chunk.map_err(|_| broken_off().closing())?;
        if bytes.len() + chunk.len() > bytes_max {
            return Err(too_large(bytes_max).closing());
        }
        bytes.extend_from_slice(&chunk);
    }
}

fn broken_off() -> Problem {
    let detail = "the body broke off before its end";
    Problem::new(ProblemKind::BadRequest, detail)
}

fn too_slow(pace: Pace) -> Problem {
    metrics::counter!("mapshift_slow_bodies_total").increment(1);
    let detail = format!(
        "the body came too slowly: {} s after its beginning it must come with {} bytes a second on average, and all of it within {} s",
        pace.grace.as_secs_f64(),
        pace.bytes_per_s,
        pace.total.as_secs_f64()
    );
    Problem::new(ProblemKind::BodyTimeout, detail)
}
