//! How an upload of a batch is received, stored and answered.

use axum::Json;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;

use super::ApiState;
use super::batch_body::BatchBody;
use super::client_address::ClientAddress;
use super::problem::{Problem, ProblemKind};
use super::upload::{decompress, receive};
use crate::ids::{BatchId, RouteId};
use crate::ingest::batch_json;
use crate::store::{BatchRecord, Journaled, NewBatch, OutOfRange};

const IDEMPOTENT_REPLAYED: HeaderName = HeaderName::from_static("idempotent-replayed");

/// Receives an upload, decodes it with `decode`, stores it, counts it, and answers.
///
/// # Errors
/// The [`Problem`] that the upload is refused with.
pub(super) async fn take_upload(
    state: &ApiState,
    client: ClientAddress,
    name: (RouteId, BatchId),
    headers: &HeaderMap,
    body: Body,
    decode: impl FnOnce(Vec<u8>, Timestamp) -> Result<NewBatch, Problem> + Send + 'static,
) -> Result<Response, Problem> {
    let outcome = store_upload(state, client, name, headers, body, decode).await;
    count_upload(outcome.as_ref().map(|(journaled, _)| *journaled));
    let (journaled, batch) = outcome?;
    upload_answer(state, journaled, batch).await
}

/// Counts an upload by how it ended: `stored`, `replayed`, or the name of a problem.
pub(super) fn count_upload(ended: Result<Journaled, &Problem>) {
    let outcome = match ended {
        Ok(Journaled::Stored) => "stored",
        Ok(_) => "replayed",
        Err(problem) => problem.kind().name(),
    };
    metrics::counter!("mapshift_uploads_total", "outcome" => outcome).increment(1);
}

/// The answer to an upload that is stored.
///
/// # Errors
/// A [`Problem`] of the store.
pub(super) async fn upload_answer(
    state: &ApiState,
    journaled: Journaled,
    batch: BatchRecord,
) -> Result<Response, Problem> {
    let alerts = match journaled {
        Journaled::Stored => Vec::new(),
        _ => state.store.batch_alerts(&batch.route_id, &batch.id).await?,
    };
    let batch = BatchBody::new(batch, &alerts).map_err(Problem::internal)?;
    Ok(if journaled == Journaled::Stored {
        let location = format!("/v1/routes/{}/batches/{}", batch.route_id, batch.id);
        let headers = [(header::LOCATION, location)];
        (StatusCode::ACCEPTED, headers, Json(batch)).into_response()
    } else {
        (StatusCode::OK, [(IDEMPOTENT_REPLAYED, "true")], Json(batch)).into_response()
    })
}

/// Reads an upload's body, decodes it off the request's thread, and stores it.
async fn store_upload(
    state: &ApiState,
    client: ClientAddress,
    name: (RouteId, BatchId),
    headers: &HeaderMap,
    body: Body,
    decode: impl FnOnce(Vec<u8>, Timestamp) -> Result<NewBatch, Problem> + Send + 'static,
) -> Result<(Journaled, BatchRecord), Problem> {
    let (route_id, id) = name;
    let upload = receive(state, client, headers, body).await?;
    let received_at = Timestamp::now();
    let body_bytes = state.limits.body_bytes;
    let (head, wire, mut places) = (upload.head, upload.wire, upload.places);
    let decoded = state.decoding.run(move || {
        head.check_digest(&wire)?;
        let body = decompress(wire, head.encoding, body_bytes)?;
        decode(body, received_at)
    });
    let batch = decoded.await??;
    places.shrink_body(batch.body.len());
    let journaled = state.store.journal_batch(batch).await?;
    drop(places);
    if journaled == Journaled::Conflict {
        return Err(Problem::new(
            ProblemKind::BatchIdReused,
            "this route has a batch with this id and other content: choose another id",
        ));
    }
    let batch = state.store.batch(&route_id, &id).await?;
    // The route may have been deleted in the meantime.
    let batch = batch.ok_or_else(Problem::unknown_route)?;
    Ok((journaled, batch))
}

/// How many readings of a batch are outside the range of their lidar.
pub(super) fn out_of_range(ranges: &batch_json::RangeCounts) -> OutOfRange {
    OutOfRange {
        above_range_max: ranges.above_range_max as i64,
        below_range_min: ranges.below_range_min as i64,
    }
}
