//! Alerts: places where the world contradicts a route's map.

mod body;
mod bulk;
mod decisions;
mod evidence;
mod evidence_body;
mod evidence_picture;
mod geojson;
mod handling;
mod observations;
mod observations_body;
mod pacing;
mod passes;
mod preview;
mod query;
mod sentence;
mod size;
mod stream;
mod suspect_body;
mod tangent_plane;

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::access::Identity;
use super::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::parameters::AlertParam;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{AlertListProblems, AlertProblems};
use crate::ids::AlertId;
use crate::store::{AlertFilter, AlertRecord};

use body::{AlertBody, etag};
pub(super) use bulk::*;
pub(super) use decisions::*;
pub(super) use evidence_body::*;
pub(super) use evidence_picture::*;
pub(super) use geojson::*;
pub(super) use handling::*;
pub(super) use observations_body::*;
pub(super) use passes::*;
pub(super) use preview::*;
use query::AlertQuery;
pub(super) use stream::*;

/// A part of the list of alerts.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct AlertPage {
    /// The newest first.
    items: Vec<AlertBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for AlertPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// List alerts.
///
/// Of all routes or of one, the newest first, in parts.
#[utoipa::path(
    get, path = "/v1/alerts", tag = "alerts",
    params(AlertQuery, PageQuery),
    responses((status = 200, description = "A part of the list", body = AlertPage), AlertListProblems)
)]
pub(super) async fn list_alerts(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<AlertQuery>,
) -> Result<Listed<AlertPage>, Problem> {
    let (alerts, next_cursor) = page(&state, &identity, &query).await?;
    Ok(Listed(AlertPage {
        items: alerts.into_iter().map(AlertBody::from).collect(),
        next_cursor,
    }))
}

/// Read an alert.
///
/// What changed, where, how sure it is, and what became of it. The ETag guards decisions.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}", tag = "alerts",
    params(AlertParam),
    responses((status = 200, description = "The alert", body = AlertBody, headers(("ETag" = String, description = "The alert's decision revision in quotes; decisions need it"))), AlertProblems)
)]
pub(super) async fn get_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
) -> Result<Response, Problem> {
    Ok(with_etag(known_alert(&state, id).await?))
}

/// An alert as this interface shows it: a JSON object.
///
/// # Errors
/// If it does not serialise.
pub fn alert_text(alert: AlertRecord) -> Result<String, serde_json::Error> {
    serde_json::to_string(&AlertBody::from(alert))
}

/// A page of the list and where the next one begins.
async fn page(
    state: &ApiState,
    identity: &Identity,
    query: &AlertQuery,
) -> Result<(Vec<AlertRecord>, Option<String>), Problem> {
    let limit = checked_limit(query.limit)?;
    let before: Option<AlertId> = key_of_cursor(query.cursor.as_deref())?;
    let filter = AlertFilter {
        among: identity.routes.clone(),
        ..query.filter()?
    };
    if let Some(route) = &filter.route_id {
        identity.check_route(route)?;
        state.known_route(route).await?;
    }
    let mut alerts = state.store.alert_page(&filter, before, limit + 1).await?;
    let next_cursor = cut_page(&mut alerts, limit, |alert| alert.id.to_string());
    Ok((alerts, next_cursor))
}

pub(super) async fn known_alert(state: &ApiState, id: AlertId) -> Result<AlertRecord, Problem> {
    state.store.alert(id).await?.ok_or_else(unknown_alert)
}

pub(super) fn unknown_alert() -> Problem {
    let detail = "there is no such alert: GET /v1/alerts lists them";
    Problem::new(ProblemKind::NotFound, detail)
}

fn with_etag(alert: AlertRecord) -> Response {
    // No 304: the rest of an alert changes under the same tag.
    let headers = [
        (header::ETAG, etag(&alert)),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ];
    (headers, Json(AlertBody::from(alert))).into_response()
}
