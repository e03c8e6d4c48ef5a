//! Batches of scans: upload, status, list.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::access::Identity;
use super::batch_upload::{BatchUpload, extensions_schema};
use super::client_address::ClientAddress;
use super::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::parameters::{BatchParam, RouteParam, UploadHeaders};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{RoutePartProblems, RouteProblems, ScanUploadProblems};
use super::upload::{decompress, receive};
use crate::ids::{AlertId, BatchId, RouteId, VehicleId};
use crate::ingest::batch_json;
use crate::model::{BatchKind, BatchStatus};
use crate::store::{BatchContent, BatchFilter, BatchRecord, Journaled, NewBatch, OutOfRange};

/// Batches that a list can be asked for by id.
const IDS_MAX: usize = 200;
const IDEMPOTENT_REPLAYED: HeaderName = HeaderName::from_static("idempotent-replayed");

/// An upload and what became of it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Batch)]
pub(super) struct BatchBody {
    /// Chosen by the client.
    #[schema(example = "b-000123")]
    id: String,
    /// The route.
    route_id: String,
    /// Who drove.
    vehicle_id: String,
    /// Which drive.
    trip_id: String,
    /// What it holds.
    kind: BatchKind,
    /// 0, 1, 2 … within the trip; of edges, in the order of arrival.
    sequence: i64,
    /// Where it is on its way.
    status: BatchStatus,
    /// Why it is there, for people.
    #[schema(required)]
    reason: Option<String>,
    /// What was noticed: `above_range_max` (readings that count as no return), `below_range_min`
    /// (readings that say nothing), `clock_skew` (its clock is more than a day ahead; a trip that
    /// begins more than a week ahead counts from its arrival, in the graph and in alerts),
    /// `clockwise_scans` (their beams were put into counter-clockwise order), `empty_scans`, `gap`
    /// (batches before it never came), `late`, `map_mended` (with it a segment of the map was put
    /// right; a resolved `map_mismatch` says which), `not_localised` (at its end nobody knew where
    /// the vehicle was), `simulated_time` (stamps before 2000: the trip counts from its arrival),
    /// `wild_odometry`, …
    flags: Vec<String>,
    /// Readings outside the range of their lidar; null for edges, and for batches that came in before
    /// these were counted.
    #[schema(required)]
    out_of_range: Option<OutOfRangeBody>,
    /// As it was sent; null if nothing was, or if the batch was erased.
    #[schema(required, schema_with = extensions_schema)]
    extensions: Option<Box<RawValue>>,
    /// Number of scans.
    scans: i64,
    /// Nodes it added to the graph.
    nodes_added: i64,
    /// Loop closures it added to the graph.
    loop_closures: i64,
    /// Alerts that rest on it, by id.
    alerts: Vec<String>,
    /// When it came in.
    #[schema(value_type = String, format = DateTime)]
    received_at: Timestamp,
    /// When it was last worked on.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    processed_at: Option<Timestamp>,
}

/// Readings of a batch outside the range of their lidar.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = OutOfRangeReadings)]
struct OutOfRangeBody {
    /// Of `range_max` or longer: they count as no return, as null does.
    above_range_max: i64,
    /// Below `range_min`, 0 and less included: they say nothing, neither that something is there nor
    /// that nothing is.
    below_range_min: i64,
}

impl From<OutOfRange> for OutOfRangeBody {
    fn from(readings: OutOfRange) -> Self {
        Self {
            above_range_max: readings.above_range_max,
            below_range_min: readings.below_range_min,
        }
    }
}

/// A part of a route's list of batches.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct BatchPage {
    /// In the order of arrival.
    items: Vec<BatchBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for BatchPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// Which batches to list.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct BatchQuery {
    /// Only these, at most 200, with commas between them: what has become of many batches, in one answer.
    /// Ids that the route does not have are left out of it.
    #[param(
        nullable = false,
        example = "b-000122,b-000123",
        pattern = "^[A-Za-z0-9._-]{1,64}(,[A-Za-z0-9._-]{1,64}){0,199}$"
    )]
    ids: Option<String>,
    /// Only this vehicle's.
    #[param(nullable = false, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: Option<String>,
    /// Only in this state.
    #[param(nullable = false, inline)]
    status: Option<BatchStatus>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    limit: Option<u32>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    cursor: Option<String>,
}

impl BatchBody {
    /// # Errors
    /// If what the store has as extensions is no JSON.
    pub(super) fn new(batch: BatchRecord, alerts: &[AlertId]) -> Result<Self, serde_json::Error> {
        let extensions = batch.extensions.map(RawValue::from_string).transpose()?;
        Ok(Self {
            id: batch.id.to_string(),
            route_id: batch.route_id.to_string(),
            vehicle_id: batch.vehicle_id.to_string(),
            trip_id: batch.trip_id.to_string(),
            kind: batch.kind,
            sequence: batch.sequence,
            status: batch.status,
            reason: batch.reason,
            flags: batch.flags,
            out_of_range: batch.out_of_range.map(OutOfRangeBody::from),
            extensions,
            scans: batch.scans,
            nodes_added: batch.nodes_added,
            loop_closures: batch.loop_closures,
            alerts: alerts.iter().map(ToString::to_string).collect(),
            received_at: batch.received_at,
            processed_at: batch.processed_at,
        })
    }
}

/// Upload a batch of scans.
///
/// Safe to repeat: the same bytes under the same id are stored once. The answer 202 means that
/// the batch is on disk; what becomes of it is its status. 408, 429, 503 and 507 mean: send the
/// same bytes under the same id again, after `Retry-After`.
#[utoipa::path(
    put, path = "/v1/routes/{route}/batches/{batch}", tag = "batches",
    params(RouteParam, BatchParam, UploadHeaders),
    request_body(content = BatchUpload, description = "At most 16 MiB as sent, 64 MiB after decompression, 20 times the compressed size"),
    responses(
        (status = 200, description = "The same bytes were stored before", body = BatchBody, headers(("Idempotent-Replayed" = String, description = "`true`"))),
        (status = 202, description = "Stored durably", body = BatchBody, headers(("Location" = String, description = "The batch"))),
        ScanUploadProblems,
    )
)]
pub(super) async fn put_batch(
    State(state): State<ApiState>,
    client: ClientAddress,
    identity: Identity,
    ApiPath((route_id, id)): ApiPath<(RouteId, BatchId)>,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let (route, batch) = (route_id.clone(), id.clone());
    let decode = move |body: Vec<u8>, received_at| {
        let batch = batch_json::decode(&body, received_at)?;
        batch.ranges.check_units()?;
        identity.check_upload(&batch.vehicle_id)?;
        Ok(NewBatch {
            vehicle_id: batch.vehicle_id,
            trip_id: batch.trip_id,
            content: BatchContent::Scans {
                sequence: batch.sequence,
                scans: batch.scans.len() as i64,
            },
            flags: batch.flags,
            out_of_range: Some(out_of_range(&batch.ranges)),
            extensions: batch.extensions,
            route_id,
            id,
            body,
            received_at,
        })
    };
    take_upload(&state, client, (route, batch), &headers, body, decode).await
}

/// Stores an upload that is decoded so, counts it, and says what became of it.
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

/// Says what became of an upload.
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
            "this route has a batch of this id with other bytes: choose another id for other content",
        ));
    }
    let batch = state.store.batch(&route_id, &id).await?;
    // The route may have been deleted since.
    let batch = batch.ok_or_else(Problem::unknown_route)?;
    Ok((journaled, batch))
}

/// Read a batch's status.
///
/// Where the batch is on its way, and what it added to the graph.
#[utoipa::path(
    get, path = "/v1/routes/{route}/batches/{batch}", tag = "batches",
    params(RouteParam, BatchParam),
    responses((status = 200, description = "The batch", body = BatchBody), RoutePartProblems)
)]
pub(super) async fn get_batch(
    State(state): State<ApiState>,
    identity: Identity,
    ApiPath((route_id, id)): ApiPath<(RouteId, BatchId)>,
    _: NoQuery,
) -> Result<Json<BatchBody>, Problem> {
    let batch = known_batch(&state, &route_id, &id).await?;
    let is_foreign = |own: &VehicleId| own.as_str() != batch.vehicle_id;
    match identity.own_vehicle().is_some_and(is_foreign) {
        true => Err(Problem::not_found("batch")),
        false => Ok(batch),
    }
}

/// A batch as it is now.
///
/// # Errors
/// The [`Problem`] that there is none.
pub(super) async fn known_batch(
    state: &ApiState,
    route: &RouteId,
    id: &BatchId,
) -> Result<Json<BatchBody>, Problem> {
    let batch = state.store.batch(route, id).await?;
    let batch = batch.ok_or_else(|| Problem::not_found("batch"))?;
    let alerts = state.store.batch_alerts(route, id).await?;
    let batch = BatchBody::new(batch, &alerts).map_err(Problem::internal)?;
    Ok(Json(batch))
}

/// How many readings of a batch count as something else than a measurement.
pub(super) fn out_of_range(ranges: &batch_json::RangeCounts) -> OutOfRange {
    OutOfRange {
        above_range_max: ranges.above_range_max as i64,
        below_range_min: ranges.below_range_min as i64,
    }
}

/// The batches that a list is asked for by id.
fn named_ids(text: &str) -> Result<Vec<BatchId>, Problem> {
    let ids: Result<Vec<BatchId>, _> = text.split(',').map(BatchId::new).collect();
    let ids = ids.map_err(|error| Problem::parameter("ids", error.to_string()))?;
    match ids.len() <= IDS_MAX {
        true => Ok(ids),
        false => Err(Problem::parameter(
            "ids",
            format!("name at most {IDS_MAX} batches at once"),
        )),
    }
}

/// List a route's batches.
///
/// In the order of arrival, in parts; of a key that uploads for one vehicle, those of this vehicle. With
/// `ids`, the status of up to 200 batches at once, all of them in one part unless `limit` says otherwise.
#[utoipa::path(
    get, path = "/v1/routes/{route}/batches", tag = "batches",
    params(RouteParam, BatchQuery, PageQuery),
    responses((status = 200, description = "A part of the list", body = BatchPage), RouteProblems)
)]
pub(super) async fn list_batches(
    State(state): State<ApiState>,
    identity: Identity,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<BatchQuery>,
) -> Result<Listed<BatchPage>, Problem> {
    let ids = query.ids.as_deref().map(named_ids).transpose()?;
    let count = ids.as_ref().map(|ids| ids.len() as u32);
    let limit = checked_limit(query.limit.or(count))?;
    let after: Option<BatchId> = key_of_cursor(query.cursor.as_deref())?;
    let vehicle_id = query.vehicle_id.map(VehicleId::new).transpose();
    let vehicle_id =
        vehicle_id.map_err(|error| Problem::parameter("vehicle_id", error.to_string()))?;
    let own = identity.own_vehicle().cloned();
    if own.is_some() && vehicle_id.is_some() && own != vehicle_id {
        return Ok(Listed(BatchPage {
            items: Vec::new(),
            next_cursor: None,
        }));
    }
    let filter = BatchFilter {
        ids,
        vehicle_id: own.or(vehicle_id),
        status: query.status,
    };
    let batches = state
        .store
        .batches(&route_id, &filter, after.as_ref(), limit + 1);
    let mut batches = batches.await?;
    let next_cursor = cut_page(&mut batches, limit, |batch| batch.id.to_string());
    let listed: Vec<BatchId> = batches.iter().map(|batch| batch.id.clone()).collect();
    let alerts = state.store.alerts_by_batch(&route_id, &listed).await?;
    let body = |batch: BatchRecord| {
        let alerts = alerts.get(&batch.id).map_or(&[][..], Vec::as_slice);
        BatchBody::new(batch, alerts).map_err(Problem::internal)
    };
    Ok(Listed(BatchPage {
        items: batches.into_iter().map(body).collect::<Result<_, _>>()?,
        next_cursor,
    }))
}
