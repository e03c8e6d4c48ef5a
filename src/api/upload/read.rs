//! Reading a body within limits of size, pace and time.

use std::time::Instant;

use axum::body::{Body, BodyDataStream, Bytes};
use futures::StreamExt;
use tokio::time::timeout_at;

use super::head::too_large;
use crate::api::limits::Pace;
use crate::api::problem::{Problem, ProblemKind};

/// Reads a body to its end.
///
/// # Errors
/// 413 as soon as it is longer than `bytes_max`, 408 as soon as it falls behind the pace, 400 if it is cut off. All
/// close the connection, because the rest of the body may still arrive.
pub(super) async fn read_body(
    body: Body,
    bytes_max: usize,
    pace: Pace,
) -> Result<Vec<u8>, Problem> {
    let mut reader = BodyReader::new(body, bytes_max, pace);
    let mut bytes = Vec::new();
    while let Some(chunk) = reader.next().await? {
        bytes.extend_from_slice(&chunk);
    }
    Ok(bytes)
}

/// A body that is read part by part.
pub(super) struct BodyReader {
    chunks: BodyDataStream,
    bytes_max: usize,
    pace: Pace,
    begun: Instant,
    bytes: usize,
}

impl BodyReader {
    pub(super) fn new(body: Body, bytes_max: usize, pace: Pace) -> Self {
        Self {
            chunks: body.into_data_stream(),
            bytes_max,
            pace,
            begun: Instant::now(),
            bytes: 0,
        }
    }

    /// The number of bytes read so far.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes as u64
    }

    /// The next part; `None` at the end.
    ///
    /// # Errors
    /// As [`read_body`].
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        let deadline = self.pace.deadline(self.begun, self.bytes());
        let chunk = timeout_at(deadline.into(), self.chunks.next()).await;
        let Some(chunk) = chunk.map_err(|_| too_slow(self.pace).closing())? else {
            return Ok(None);
        };
        let chunk = chunk.map_err(|_| broken_off().closing())?;
        if self.bytes + chunk.len() > self.bytes_max {
            return Err(too_large(self.bytes_max).closing());
        }
        self.bytes += chunk.len();
        Ok(Some(chunk))
    }
}

fn broken_off() -> Problem {
    let detail = "the body was cut off before its end";
    Problem::new(ProblemKind::BadRequest, detail)
}

fn too_slow(pace: Pace) -> Problem {
    metrics::counter!("mapshift_slow_bodies_total").increment(1);
    let detail = format!(
        "the body arrived too slowly: from {} s after its beginning it must arrive with {} bytes a second on average, and all of it within {} s",
        pace.grace.as_secs_f64(),
        pace.bytes_per_s,
        pace.total.as_secs_f64()
    );
    Problem::new(ProblemKind::BodyTimeout, detail)
}
