//! Zones: parts of a route's map where alerts are treated differently.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use uuid::Uuid;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::if_match::{bound_revision, stale};
use super::paging::{Listed, PageQuery, page};
use super::parameters::{IfMatch, RouteParam, ZoneParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{
    RoutePartProblems, RouteProblems, ZoneCreationProblems, ZoneDeletionProblems, ZonePutProblems,
};
use super::upload::SmallJson;
use super::zone_body::{ZoneBody, ZonePut};
use crate::ids::{RouteId, ZoneId};
use crate::model::Actor;
use crate::store::{Edited, ZONES_MAX, ZoneEdit, ZoneMade, ZoneRecord};

page! {
    /// A page of the list of zones.
    pub(super) struct ZonePage {
        /// The oldest first.
        items: Vec<ZoneBody>,
    }
}

/// List the zones of a route.
///
/// The oldest first, including zones that have ended, until they are deleted.
#[utoipa::path(
    get, path = "/v1/routes/{route}/zones", tag = "alerts", params(RouteParam, PageQuery),
    responses((status = 200, description = "A page of the list", body = ZonePage), RouteProblems)
)]
pub(super) async fn list_zones(
    State(state): State<ApiState>,
    ApiPath(route): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<ZonePage>, Problem> {
    let wanted = query.wanted::<ZoneId>()?;
    let zones = state.store.zones(&route, wanted.after, wanted.to_read());
    Ok(wanted.page(zones.await?, |zone| zone.id, ZoneBody::from))
}

/// Create a zone.
///
/// It takes effect at once. While it lasts, alerts located in it are recorded and shown with `"muted": true`, are
/// not sent to webhooks, and do not count among the open alerts. When it ends, alerts that still await a decision
/// count again and are sent to webhooks. A route has at most 200 zones.
#[utoipa::path(
    post, path = "/v1/routes/{route}/zones", tag = "alerts", params(RouteParam),
    request_body(content = ZonePut, description = "The zone"),
    responses((status = 201, description = "The zone", body = ZoneBody, headers(("ETag" = String, description = "Changes with every edit"), ("Location" = String, description = "The zone"))), ZoneCreationProblems)
)]
pub(super) async fn create_zone(
    State(state): State<ApiState>,
    ApiPath(route): ApiPath<RouteId>,
    _: NoQuery,
    by: Actor,
    SmallJson(put): SmallJson<ZonePut>,
) -> Result<Response, Problem> {
    let (id, now) = (ZoneId(Uuid::now_v7()), Timestamp::now());
    let edit = put.check(now)?;
    match state.store.create_zone(&route, id, edit, &by, now).await? {
        ZoneMade::Created => {}
        ZoneMade::UnknownRoute => return Err(Problem::unknown_route()),
        ZoneMade::TooMany => {
            let detail = format!("a route has at most {ZONES_MAX} zones: delete one first");
            return Err(Problem::new(ProblemKind::TooManyZones, detail));
        }
    }
    let location = [(header::LOCATION, format!("/v1/routes/{route}/zones/{id}"))];
    let zone = with_etag(known_zone(&state, &route, id).await?);
    Ok((StatusCode::CREATED, location, zone).into_response())
}

/// Read a zone.
///
/// Its place, its effect, and when it ends.
#[utoipa::path(
    get, path = "/v1/routes/{route}/zones/{zone}", tag = "alerts", params(RouteParam, ZoneParam),
    responses((status = 200, description = "The zone", body = ZoneBody, headers(("ETag" = String, description = "Changes with every edit"))), RoutePartProblems)
)]
pub(super) async fn get_zone(
    State(state): State<ApiState>,
    ApiPath((route, id)): ApiPath<(RouteId, ZoneId)>,
    _: NoQuery,
) -> Result<Response, Problem> {
    Ok(with_etag(known_zone(&state, &route, id).await?).into_response())
}

/// Replace a zone.
///
/// Fields that are left out have the value of a new zone. A zone that has ended takes effect again.
#[utoipa::path(
    put, path = "/v1/routes/{route}/zones/{zone}", tag = "alerts",
    params(RouteParam, ZoneParam, IfMatch),
    request_body(content = ZonePut, description = "The zone"),
    responses((status = 200, description = "The zone as it is now", body = ZoneBody, headers(("ETag" = String, description = "Changes with every edit"))), ZonePutProblems)
)]
pub(super) async fn put_zone(
    State(state): State<ApiState>,
    ApiPath((route, id)): ApiPath<(RouteId, ZoneId)>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    SmallJson(put): SmallJson<ZonePut>,
) -> Result<Response, Problem> {
    let edit = put.check(Timestamp::now())?;
    edit_zone(&state, &route, id, &headers, Some(edit), &by).await?;
    Ok(with_etag(known_zone(&state, &route, id).await?).into_response())
}

/// Delete a zone.
///
/// As if it had ended: its alerts are treated like all others again.
#[utoipa::path(
    delete, path = "/v1/routes/{route}/zones/{zone}", tag = "alerts",
    params(RouteParam, ZoneParam, IfMatch),
    responses((status = 204, description = "Deleted"), ZoneDeletionProblems)
)]
pub(super) async fn delete_zone(
    State(state): State<ApiState>,
    ApiPath((route, id)): ApiPath<(RouteId, ZoneId)>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    edit_zone(&state, &route, id, &headers, None, &by).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Replaces or deletes a zone if it has the ETag in `If-Match`.
async fn edit_zone(
    state: &ApiState,
    route: &RouteId,
    id: ZoneId,
    headers: &HeaderMap,
    edit: Option<ZoneEdit>,
    by: &Actor,
) -> Result<(), Problem> {
    let zone = known_zone(state, route, id).await?;
    let revision = bound_revision(headers, &etag(&zone), zone.revision, "zone")?;
    let edited = state
        .store
        .edit_zone(route, id, revision, edit, by, Timestamp::now());
    match edited.await? {
        Edited::Done => Ok(()),
        Edited::Stale => Err(stale("zone")),
        Edited::Unknown => Err(Problem::not_found("zone")),
    }
}

async fn known_zone(state: &ApiState, route: &RouteId, id: ZoneId) -> Result<ZoneRecord, Problem> {
    let zone = state.store.zone(route, id).await?;
    zone.ok_or_else(|| Problem::not_found("zone"))
}

fn etag(zone: &ZoneRecord) -> String {
    format!("\"{}\"", zone.revision)
}

fn with_etag(zone: ZoneRecord) -> impl IntoResponse {
    ([(header::ETAG, etag(&zone))], Json(ZoneBody::from(zone)))
}
