//! Writing a large body into a file.

use std::fs::File;
use std::io;

use axum::body::Body;
use sha2::{Digest, Sha256};
use tokio::io::AsyncWriteExt;

use super::read::BodyReader;
use crate::api::limits::Pace;
use crate::api::problem::Problem;
use crate::store::StoreError;

/// Writes a body into a file; returns the file, the SHA-256 and the length of the body.
///
/// # Errors
/// As [`BodyReader::next`]; 507 if the disk is full.
pub(super) async fn spool_body(
    body: Body,
    bytes_max: usize,
    pace: Pace,
    file: File,
) -> Result<(File, [u8; 32], u64), Problem> {
    let mut reader = BodyReader::new(body, bytes_max, pace);
    let mut file = tokio::fs::File::from_std(file);
    let mut sha256 = Sha256::new();
    while let Some(chunk) = reader.next().await? {
        sha256.update(&chunk);
        file.write_all(&chunk).await.map_err(not_written)?;
    }
    file.flush().await.map_err(not_written)?;
    Ok((
        file.into_std().await,
        sha256.finalize().into(),
        reader.bytes(),
    ))
}

fn not_written(error: io::Error) -> Problem {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            Problem::from(StoreError::Full)
        }
        _ => Problem::internal(error),
    }
    .closing()
}
