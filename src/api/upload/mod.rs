//! The way of a request's body in: cheap checks, a reserved place, a bounded read, decompression.

mod decompress;
mod head;
mod read;
mod spool;

use std::fs::File;

use axum::body::Body;
use axum::http::HeaderMap;
use serde::de::DeserializeOwned;
use tokio::sync::OwnedSemaphorePermit;

pub(super) use decompress::decompress;
pub(super) use head::{Encoding, UploadHead};

use super::ApiState;
use super::client_address::ClientAddress;
use super::problem::Problem;
use super::shares::Share;
use crate::ingest::json::{Object, from_json};

/// The bytes of an upload as they were sent, with the places it holds until it is stored.
pub(super) struct Upload {
    pub head: UploadHead,
    pub wire: Vec<u8>,
    pub places: Places,
}

/// What an upload has reserved; given back when dropped.
pub(super) struct Places {
    _slot: Share,
    _wire: Share,
    body: Option<OwnedSemaphorePermit>,
}

impl Places {
    /// Gives back what was reserved for a larger body than it turned out to be.
    pub(super) fn shrink_body(&mut self, bytes: usize) {
        if let Some(body) = &mut self.body {
            let excess = body.num_permits().saturating_sub(kibibytes(bytes));
            drop(body.split(excess));
        }
    }
}

/// Checks the headers, reserves a place, and only then reads the body.
///
/// # Errors
/// 400, 408, 413, 415, 429 when the client's address has its share of the places, or 503 when none is
/// free.
pub(super) async fn receive(
    state: &ApiState,
    client: ClientAddress,
    headers: &HeaderMap,
    body: Body,
) -> Result<Upload, Problem> {
    let limits = &state.limits;
    let head = UploadHead::check(headers, limits.wire_bytes)?;
    let announced = head.content_length.unwrap_or(limits.wire_bytes);
    let slot = state.upload_slots.try_take(client, 1);
    let slot = slot.map_err(Problem::closing)?;
    let wire_place = state.wire_budget.try_take(client, announced);
    let wire_place = wire_place.map_err(Problem::closing)?;
    let wire = read::read_body(body, limits.wire_bytes, limits.body_pace).await?;
    let most = match head.encoding {
        Encoding::Identity => wire.len(),
        Encoding::Gzip | Encoding::Zstd => decompress::most(wire.len(), limits.body_bytes),
    };
    let budget = state.body_budget.clone();
    let body_place = budget.acquire_many_owned(kibibytes(most) as u32).await;
    Ok(Upload {
        head,
        wire,
        places: Places {
            _slot: slot,
            _wire: wire_place,
            body: Some(body_place.map_err(Problem::internal)?),
        },
    })
}

/// A recording on the disk, with the places it holds until it is stored.
pub(super) struct ReceivedRecording {
    pub file: File,
    pub sha256: [u8; 32],
    pub bytes: u64,
    pub places: RecordingPlaces,
}

/// What the upload of a recording has reserved; given back when dropped.
pub(super) struct RecordingPlaces {
    _slot: Share,
    _recording: Share,
}

/// Checks the headers, reserves a place, and only then reads the body into a file.
///
/// # Errors
/// As [`receive`]; 507 if the disk is full.
pub(super) async fn receive_recording(
    state: &ApiState,
    client: ClientAddress,
    headers: &HeaderMap,
    body: Body,
) -> Result<ReceivedRecording, Problem> {
    let limits = &state.limits;
    let head = UploadHead::check_recording(headers, limits.recording_bytes)?;
    let slot = state.upload_slots.try_take(client, 1);
    let recording = state.recordings.try_take(client, 1);
    let places = RecordingPlaces {
        _slot: slot.map_err(Problem::closing)?,
        _recording: recording.map_err(Problem::closing)?,
    };
    let bytes_max = limits.recording_bytes;
    let announced = head.content_length.unwrap_or(bytes_max);
    let file = state.store.temporary_file(announced as u64).await;
    let file = file.map_err(|error| Problem::from(error).closing())?;
    let spooled = spool::spool_body(body, bytes_max, limits.body_pace, file).await?;
    let (file, sha256, bytes) = spooled;
    head.check_sha256(&sha256)?;
    Ok(ReceivedRecording {
        file,
        sha256,
        bytes,
        places,
    })
}

/// Reads a small JSON object; no body at all counts as `{}`.
///
/// # Errors
/// 400, 408, 413, 415.
pub(super) async fn small_json<T: DeserializeOwned>(
    state: &ApiState,
    headers: &HeaderMap,
    body: Body,
) -> Result<T, Problem> {
    let limits = &state.limits;
    let has_type = headers.contains_key(axum::http::header::CONTENT_TYPE);
    if has_type {
        head::check_media_type(headers)?;
    }
    head::check_plain(headers)?;
    let bytes = read::read_body(body, limits.small_body_bytes, limits.body_pace).await?;
    if bytes.is_empty() {
        return Ok(from_json::<Object<T>>(b"{}")?.0);
    }
    if !has_type {
        head::check_media_type(headers)?;
    }
    Ok(from_json::<Object<T>>(&bytes)?.0)
}

fn kibibytes(bytes: usize) -> usize {
    bytes.div_ceil(1 << 10)
}
