//! Batches of scans: upload, status, list.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;

use super::ApiState;
use super::access::Identity;
use super::batch_body::BatchBody;
use super::batch_intake::{out_of_range, take_upload};
use super::batch_upload::BatchUpload;
use super::client_address::ClientAddress;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::filters::checked_vehicle;
use super::paging::{Listed, Page as _, PageQuery, Wanted, page};
use super::parameters::{BatchParam, RouteParam, UploadHeaders};
use super::problem::Problem;
use super::problem_responses::{RoutePartProblems, RouteProblems, ScanUploadProblems};
use crate::ids::{BatchId, RouteId, VehicleId};
use crate::ingest::batch_json;
use crate::model::BatchStatus;
use crate::store::{BatchContent, BatchFilter, BatchRecord, NewBatch};

/// Most batches that a list can be asked for by id.
const IDS_MAX: usize = 200;

page! {
    /// A page of a route's list of batches.
    pub(super) struct BatchPage {
        /// In the order of arrival.
        items: Vec<BatchBody>,
    }
}

/// Which batches to list.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct BatchQuery {
    /// Only the batches with these ids, at most 200, separated by commas: the status of many batches in one answer.
    /// Unknown ids are left out of it.
    #[param(
        nullable = false,
        example = "b-000122,b-000123",
        pattern = "^[A-Za-z0-9._-]{1,64}(,[A-Za-z0-9._-]{1,64}){0,199}$"
    )]
    ids: Option<String>,
    /// Only batches of this vehicle.
    #[param(nullable = false, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: Option<String>,
    /// Only batches with this status.
    #[param(nullable = false, inline)]
    status: Option<BatchStatus>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    limit: Option<u32>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    cursor: Option<String>,
}

/// Upload a batch of scans.
///
/// Safe to repeat: the same bytes under the same id are stored once. The answer 202 means that the batch is on
/// disk; its status shows how it is processed. After 408, 429, 503 or 507, send the same bytes under the same id
/// again once `Retry-After` has passed.
#[utoipa::path(
    put, path = "/v1/routes/{route}/batches/{batch}", tag = "batches",
    params(RouteParam, BatchParam, UploadHeaders),
    request_body(content = BatchUpload, description = "At most 16 MiB as sent, 64 MiB after decompression, 20 times the compressed size"),
    responses(
        (status = 200, description = "The same bytes have been stored before", body = BatchBody, headers(("Idempotent-Replayed" = String, description = "`true`"))),
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

/// Read a batch's status.
///
/// How far it has been processed, and what it added to the graph.
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

/// The ids that the parameter `ids` names.
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
/// In the order of arrival; for a key that uploads for one vehicle, only that vehicle's. With `ids`, up to 200
/// named batches at once, in one page unless `limit` is given.
#[utoipa::path(
    get, path = "/v1/routes/{route}/batches", tag = "batches",
    params(RouteParam, BatchQuery, PageQuery),
    responses((status = 200, description = "A page of the list", body = BatchPage), RouteProblems)
)]
pub(super) async fn list_batches(
    State(state): State<ApiState>,
    identity: Identity,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<BatchQuery>,
) -> Result<Listed<BatchPage>, Problem> {
    let ids = query.ids.as_deref().map(named_ids).transpose()?;
    let count = ids.as_ref().map(|ids| ids.len() as u32);
    let wanted: Wanted<BatchId> = Wanted::checked(query.limit.or(count), query.cursor.as_deref())?;
    let vehicle_id = checked_vehicle(query.vehicle_id.as_deref())?;
    let own = identity.own_vehicle().cloned();
    if own.is_some() && vehicle_id.is_some() && own != vehicle_id {
        return Ok(Listed(BatchPage::new(Vec::new(), None)));
    }
    let filter = BatchFilter {
        ids,
        vehicle_id: own.or(vehicle_id),
        status: query.status,
    };
    let batches = state
        .store
        .batches(&route_id, &filter, wanted.after.as_ref(), wanted.to_read());
    let (batches, next_cursor) = wanted.cut(batches.await?, |batch| batch.id.clone());
    let listed: Vec<BatchId> = batches.iter().map(|batch| batch.id.clone()).collect();
    let alerts = state.store.alerts_by_batch(&route_id, &listed).await?;
    let body = |batch: BatchRecord| {
        let alerts = alerts.get(&batch.id).map_or(&[][..], Vec::as_slice);
        BatchBody::new(batch, alerts).map_err(Problem::internal)
    };
    let items = batches.into_iter().map(body).collect::<Result<_, _>>()?;
    Ok(Listed(BatchPage::new(items, next_cursor)))
}
