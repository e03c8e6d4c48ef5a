//! Zones: parts of a route's map where alerts are treated otherwise.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::schema::{Array, ArrayBuilder, ObjectBuilder, Type};
use uuid::Uuid;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use super::if_match::if_match;
use super::note::checked_note;
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::parameters::{IfZoneMatches, RouteParam, ZoneParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{
    RoutePartProblems, RouteProblems, ZoneCreationProblems, ZoneDeletionProblems, ZonePutProblems,
};
use super::upload::small_json;
use crate::geometry::{Vector2, is_simple_polygon, polygon_area};
use crate::ids::{RouteId, ZoneId};
use crate::model::{Actor, ChangeKind, ZonePurpose};
use crate::store::{Edited, ZONES_MAX, ZoneEdit, ZoneMade, ZoneRecord};

const CORNERS_MAX: usize = 100;
/// Farther from the origin no map reaches, metres.
const REACH_M: f64 = 1e6;
/// A smaller polygon holds the location of no alert, square metres.
const AREA_MIN_M2: f64 = 0.01;

/// What a zone is to be.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ZoneEdit, example = json!({"polygon": [[4.0, 1.0], [9.0, 1.0], [9.0, 5.0], [4.0, 5.0]], "purpose": "mute", "kinds": ["appeared"], "until": "2026-11-20T14:00:00Z", "note": "pallets until the shift ends"}))]
pub(super) struct ZonePut {
    /// Corners x, y of a simple polygon in the map frame, metres, not closed; at least 0.01 m² large.
    #[schema(schema_with = polygon)]
    polygon: Vec<[f64; 2]>,
    /// What it does.
    purpose: ZonePurpose,
    /// With alerts of these kinds alone; all kinds if null or left out.
    #[schema(min_items = 1)]
    kinds: Option<Vec<ChangeKind>>,
    /// When it ends by itself, which is in the future; never if null or left out.
    #[schema(value_type = Option<String>, format = DateTime)]
    until: Option<Timestamp>,
    /// Why, for people.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
}

/// A part of a route's map where alerts are treated otherwise.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Zone)]
pub(super) struct ZoneBody {
    /// UUID of version 7: sorts by when the zone was made.
    #[schema(format = "uuid")]
    id: String,
    /// The route.
    route_id: String,
    /// Corners x, y, map frame, metres, not closed.
    #[schema(schema_with = polygon)]
    polygon: Vec<[f64; 2]>,
    /// What it does.
    purpose: ZonePurpose,
    /// With alerts of these kinds alone; null for all.
    #[schema(required)]
    kinds: Option<Vec<ChangeKind>>,
    /// When it ends by itself; null if it does not.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    until: Option<Timestamp>,
    /// When it did; null while it is in effect.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    ended_at: Option<Timestamp>,
    /// Why, for people.
    #[schema(required)]
    note: Option<String>,
    /// When it was made.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// By whom.
    created_by: String,
    /// When it was last edited.
    #[schema(value_type = String, format = DateTime)]
    updated_at: Timestamp,
}

/// A part of the list of zones.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ZonePage {
    /// The oldest first.
    items: Vec<ZoneBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for ZonePage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

impl From<ZoneRecord> for ZoneBody {
    fn from(zone: ZoneRecord) -> Self {
        let edit = zone.edit;
        let corners = edit.polygon.iter().map(|corner| [corner.x, corner.y]);
        Self {
            id: zone.id.to_string(),
            route_id: zone.route_id.to_string(),
            polygon: corners.collect(),
            purpose: edit.purpose,
            kinds: edit.kinds,
            until: edit.until,
            ended_at: zone.ended_at,
            note: edit.note,
            created_at: zone.created_at,
            created_by: zone.created_by,
            updated_at: zone.updated_at,
        }
    }
}

/// The schema of a polygon: so many corners, each an x and a y.
fn polygon() -> Array {
    let number = ObjectBuilder::new().schema_type(Type::Number);
    let corner = ArrayBuilder::new()
        .items(number)
        .min_items(Some(2))
        .max_items(Some(2));
    ArrayBuilder::new()
        .items(corner)
        .min_items(Some(3))
        .max_items(Some(CORNERS_MAX))
        .build()
}

impl ZonePut {
    fn check(self, now: Timestamp) -> Result<ZoneEdit, Problem> {
        let refuse = |pointer: &str, detail: &str| {
            Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer))
        };
        let polygon: Vec<_> = self.polygon.into_iter().map(Vector2::from).collect();
        if !(3..=CORNERS_MAX).contains(&polygon.len()) {
            return refuse("/polygon", "a polygon has 3 to 100 corners");
        }
        let mut values = polygon.iter().flat_map(|corner| corner.iter());
        if values.any(|value| value.is_nan() || value.abs() > REACH_M) {
            return refuse(
                "/polygon",
                "corners are metres in the map frame, at most 1e6",
            );
        }
        if !is_simple_polygon(&polygon) {
            let detail = "the sides of a polygon meet at its corners alone: send the corners in order \
                          round it, each once, the first one not again at the end";
            return refuse("/polygon", detail);
        }
        if polygon_area(&polygon) < AREA_MIN_M2 {
            return refuse("/polygon", "a zone is at least 0.01 m² large");
        }
        if self.until.is_some_and(|until| until <= now) {
            return refuse(
                "/until",
                "until is in the past: send a time to come, or null",
            );
        }
        let mut kinds = self.kinds;
        if let Some(kinds) = &mut kinds {
            kinds.sort_unstable();
            kinds.dedup();
            if kinds.is_empty() {
                return refuse("/kinds", "name at least one kind, or send null for all");
            }
        }
        Ok(ZoneEdit {
            polygon,
            purpose: self.purpose,
            kinds,
            until: self.until,
            note: checked_note(self.note)?,
        })
    }
}

/// List the zones of a route.
///
/// The oldest first, in parts; also those whose time is over, until they are deleted.
#[utoipa::path(
    get, path = "/v1/routes/{route}/zones", tag = "alerts", params(RouteParam, PageQuery),
    responses((status = 200, description = "A part of the list", body = ZonePage), RouteProblems)
)]
pub(super) async fn list_zones(
    State(state): State<ApiState>,
    ApiPath(route): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<ZonePage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<ZoneId> = key_of_cursor(query.cursor.as_deref())?;
    let mut zones = state.store.zones(&route, after, limit + 1).await?;
    let next_cursor = cut_page(&mut zones, limit, |zone| zone.id.to_string());
    Ok(Listed(ZonePage {
        items: zones.into_iter().map(ZoneBody::from).collect(),
        next_cursor,
    }))
}

/// Make a zone.
///
/// It takes effect at once. While it lasts, alerts that are located in it are recorded and shown with
/// `"muted": true`; webhooks are not sent them, and they do not count among the open alerts. Once it is
/// over, those that still wait count again, and webhooks are sent what they have missed. A route has at
/// most 200 zones.
#[utoipa::path(
    post, path = "/v1/routes/{route}/zones", tag = "alerts", params(RouteParam),
    request_body(content = ZonePut, description = "What it is to be"),
    responses((status = 201, description = "The zone", body = ZoneBody, headers(("ETag" = String, description = "Changes with every edit"), ("Location" = String, description = "The zone"))), ZoneCreationProblems)
)]
pub(super) async fn create_zone(
    State(state): State<ApiState>,
    ApiPath(route): ApiPath<RouteId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let put: ZonePut = small_json(&state, &headers, body).await?;
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
/// Where it is, what it does and until when.
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
/// All of it; what is left out is as in a new zone. One whose time was over takes effect again.
#[utoipa::path(
    put, path = "/v1/routes/{route}/zones/{zone}", tag = "alerts",
    params(RouteParam, ZoneParam, IfZoneMatches),
    request_body(content = ZonePut, description = "What it is to be"),
    responses((status = 200, description = "The zone as it is now", body = ZoneBody, headers(("ETag" = String, description = "Changes with every edit"))), ZonePutProblems)
)]
pub(super) async fn put_zone(
    State(state): State<ApiState>,
    ApiPath((route, id)): ApiPath<(RouteId, ZoneId)>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let put: ZonePut = small_json(&state, &headers, body).await?;
    let edit = put.check(Timestamp::now())?;
    edit_zone(&state, &route, id, &headers, Some(edit), &by).await?;
    Ok(with_etag(known_zone(&state, &route, id).await?).into_response())
}

/// Delete a zone.
///
/// Its alerts are treated as all others again, as if its time were over.
#[utoipa::path(
    delete, path = "/v1/routes/{route}/zones/{zone}", tag = "alerts",
    params(RouteParam, ZoneParam, IfZoneMatches),
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

/// Replaces or deletes a zone, if it is as `If-Match` says.
async fn edit_zone(
    state: &ApiState,
    route: &RouteId,
    id: ZoneId,
    headers: &HeaderMap,
    edit: Option<ZoneEdit>,
    by: &Actor,
) -> Result<(), Problem> {
    let zone = known_zone(state, route, id).await?;
    let revision = match if_match(headers, &etag(&zone)) {
        None => None,
        Some(true) => Some(zone.revision),
        Some(false) => return Err(stale()),
    };
    let edited = state
        .store
        .edit_zone(route, id, revision, edit, by, Timestamp::now());
    match edited.await? {
        Edited::Done => Ok(()),
        Edited::Stale => Err(stale()),
        Edited::Unknown => Err(Problem::not_found("zone")),
    }
}

async fn known_zone(state: &ApiState, route: &RouteId, id: ZoneId) -> Result<ZoneRecord, Problem> {
    let zone = state.store.zone(route, id).await?;
    zone.ok_or_else(|| Problem::not_found("zone"))
}

fn stale() -> Problem {
    let detail = "the zone is not as If-Match says: read it again";
    Problem::new(ProblemKind::PreconditionFailed, detail).at("If-Match")
}

fn etag(zone: &ZoneRecord) -> String {
    format!("\"{}\"", zone.revision)
}

fn with_etag(zone: ZoneRecord) -> impl IntoResponse {
    ([(header::ETAG, etag(&zone))], Json(ZoneBody::from(zone)))
}
