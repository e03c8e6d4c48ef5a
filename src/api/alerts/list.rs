//! The list of alerts, and reading one of them.

use axum::extract::State;
use axum::response::Response;

use super::body::{AlertBody, with_etag};
use super::known::known_alert;
use super::query::AlertQuery;
use crate::api::ApiState;
use crate::api::access::Identity;
use crate::api::extract::{ApiPath, ApiQuery, NoQuery};
use crate::api::paging::{Listed, Page as _, PageQuery, Wanted, page};
use crate::api::parameters::AlertParam;
use crate::api::problem::Problem;
use crate::api::problem_responses::{AlertListProblems, AlertProblems};
use crate::ids::AlertId;
use crate::store::{AlertFilter, AlertRecord};

page! {
    /// A page of the list of alerts.
    pub(in crate::api) struct AlertPage {
        /// The newest first.
        items: Vec<AlertBody>,
    }
}

/// List alerts.
///
/// The newest first, of all routes or of one.
#[utoipa::path(
    get, path = "/v1/alerts", tag = "alerts",
    params(AlertQuery, PageQuery),
    responses((status = 200, description = "A page of the list", body = AlertPage), AlertListProblems)
)]
pub(in crate::api) async fn list_alerts(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<AlertQuery>,
) -> Result<Listed<AlertPage>, Problem> {
    let (alerts, next_cursor) = listed(&state, &identity, &query).await?;
    let items = alerts.into_iter().map(AlertBody::from).collect();
    Ok(Listed(AlertPage::new(items, next_cursor)))
}

/// Read an alert.
///
/// What changed, where, how certain that is, and what was decided. The ETag guards decisions.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}", tag = "alerts",
    params(AlertParam),
    responses((status = 200, description = "The alert", body = AlertBody, headers(("ETag" = String, description = "The alert's decision revision in quotes; decisions need it"))), AlertProblems)
)]
pub(in crate::api) async fn get_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
) -> Result<Response, Problem> {
    Ok(with_etag(known_alert(&state, id).await?))
}

/// The alerts of a page, and the cursor of the next one.
///
/// # Errors
/// 400 for parameters that are not usable, 404 for a route that is not there.
pub(super) async fn listed(
    state: &ApiState,
    identity: &Identity,
    query: &AlertQuery,
) -> Result<(Vec<AlertRecord>, Option<String>), Problem> {
    let wanted: Wanted<AlertId> = Wanted::checked(query.limit, query.cursor.as_deref())?;
    let filter = AlertFilter {
        among: identity.routes.clone(),
        ..query.filter()?
    };
    if let Some(route) = &filter.route_id {
        identity.check_route(route)?;
        state.known_route(route).await?;
    }
    let alerts = state
        .store
        .alert_page(&filter, wanted.after, wanted.to_read());
    Ok(wanted.cut(alerts.await?, |alert| alert.id))
}
