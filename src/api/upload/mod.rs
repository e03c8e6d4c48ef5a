//! Receiving the body of a request: cheap checks, a reserved place, a bounded read, decompression.

mod decompress;
mod head;
mod read;
mod small_json;
mod spool;

use std::fs::File;

use axum::body::Body;
use axum::http::HeaderMap;
use tokio::sync::OwnedSemaphorePermit;

pub(super) use decompress::decompress;
pub(super) use head::{Encoding, UploadHead};
pub(super) use small_json::{SmallJson, small_json};

use super::ApiState;
use super::client_address::ClientAddress;
use super::problem::Problem;
use super::shares::Share;

/// The bytes of an upload as they were sent, and the places that it holds until it is stored.
pub(super) struct Upload {
    pub head: UploadHead,
    pub wire: Vec<u8>,
    pub places: Places,
}

/// What an upload has reserved; released when dropped.
pub(super) struct Places {
    _slot: Share,
    _wire: Share,
    body: Option<OwnedSemaphorePermit>,
}

impl Places {
    /// Releases what was reserved in excess of the actual size of the body.
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
/// 400, 408, 413 or 415; 429 if the client's address has its share of the places; 503 if none is free.
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

/// A recording in a file, and the places that it holds until it is stored.
pub(super) struct ReceivedRecording {
    pub file: File,
    pub sha256: [u8; 32],
    pub bytes: u64,
    pub places: RecordingPlaces,
}

/// What the upload of a recording has reserved; released when dropped.
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

fn kibibytes(bytes: usize) -> usize {
    bytes.div_ceil(1 << 10)
}
