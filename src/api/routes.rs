//! Routes: one map, one pose graph each.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;

use super::ApiState;
use super::access::Identity;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::if_match::{if_match, stale};
use super::paging::{Listed, PageQuery, page};
use super::parameters::{IfMatch, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{
    AnyProblems, RouteDeletionProblems, RouteProblems, RoutePutProblems,
};
use super::route_body::RouteBody;
use super::route_put::RoutePut;
use super::upload::SmallJson;
use crate::ids::RouteId;
use crate::model::Actor;
use crate::store::{Deleted, Put, RouteEdition, RouteRecord, RouteUpdate};

page! {
    /// A page of the list of routes.
    pub(super) struct RoutePage {
        /// By id.
        items: Vec<RouteBody>,
    }
}

/// The ETag of a route: changes with every processed batch and every edit.
fn etag(route: &RouteRecord) -> String {
    let edited = route.updated_at.as_microsecond();
    format!("\"{}-{edited:x}\"", route.revision)
}

fn with_etag(status: StatusCode, route: RouteRecord) -> Response {
    let tag = etag(&route);
    (status, [(header::ETAG, tag)], Json(RouteBody::from(route))).into_response()
}

/// The edition of the route that `If-Match` allows to be written; `None` without the header.
///
/// # Errors
/// 412 if the route has another ETag, or does not exist.
async fn expected(
    state: &ApiState,
    headers: &HeaderMap,
    id: &RouteId,
) -> Result<Option<RouteEdition>, Problem> {
    if !headers.contains_key(header::IF_MATCH) {
        return Ok(None);
    }
    let current = state.store.route(id).await?;
    let is_expected = |route: &RouteRecord| if_match(headers, &etag(route)).unwrap_or(true);
    let route = current.filter(is_expected).ok_or_else(|| stale("route"))?;
    Ok(Some(route.edition()))
}

/// Create or change a route.
///
/// Creates the route if it does not exist. Fields that are left out keep their value.
#[utoipa::path(
    put, path = "/v1/routes/{route}", tag = "routes",
    params(RouteParam, IfMatch),
    request_body(content = RoutePut, description = "What to set"),
    responses(
        (status = 200, description = "Changed", body = RouteBody, headers(("ETag" = String, description = "Changes with the route"))),
        (status = 201, description = "Created", body = RouteBody, headers(("ETag" = String, description = "Changes with the route"))),
        RoutePutProblems,
    )
)]
pub(super) async fn put_route(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<RouteId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    SmallJson(put): SmallJson<RoutePut>,
) -> Result<Response, Problem> {
    let update = RouteUpdate {
        expected: expected(&state, &headers, &id).await?,
        ..put.check()?
    };
    let put = state.store.put_route(&id, update, &by, Timestamp::now());
    let status = match put.await? {
        Put::Created => StatusCode::CREATED,
        Put::Updated => StatusCode::OK,
        Put::Stale => return Err(stale("route")),
        // A map that was built for one detector cannot be continued for another.
        Put::DetectorFixed => {
            let detail = "choose the detector before the first batch, or make another route";
            let problem = Problem::new(ProblemKind::DetectorFixed, detail);
            return Err(problem.at("/settings/detector"));
        }
    };
    let route = state.known_route(&id).await?;
    Ok(with_etag(status, route))
}

/// Read a route.
///
/// Its settings, what it holds, and whether uploads are still waiting to be processed.
#[utoipa::path(
    get, path = "/v1/routes/{route}", tag = "routes",
    params(RouteParam),
    responses((status = 200, description = "The route", body = RouteBody, headers(("ETag" = String, description = "Changes with the route"))), RouteProblems)
)]
pub(super) async fn get_route(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<RouteId>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let route = state.known_route(&id).await?;
    Ok(with_etag(StatusCode::OK, route))
}

/// List routes.
///
/// All routes by id; for a key that is limited to routes, only those.
#[utoipa::path(
    get, path = "/v1/routes", tag = "routes", params(PageQuery),
    responses((status = 200, description = "A page of the list", body = RoutePage), AnyProblems)
)]
pub(super) async fn list_routes(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<RoutePage>, Problem> {
    let wanted = query.wanted::<RouteId>()?;
    let (store, after, limit) = (&state.store, wanted.after.as_ref(), wanted.to_read());
    let routes = match &identity.routes {
        None => store.routes(after, limit).await?,
        Some(own) => store.routes_among(own, after, limit).await?,
    };
    Ok(wanted.page(routes, |route| route.id.clone(), RouteBody::from))
}

/// Delete a route.
///
/// Deletes the route with its batches, its graph and its map, permanently.
#[utoipa::path(
    delete, path = "/v1/routes/{route}", tag = "routes",
    params(RouteParam, IfMatch),
    responses((status = 204, description = "Deleted"), RouteDeletionProblems)
)]
pub(super) async fn delete_route(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<RouteId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    if headers.contains_key(header::IF_MATCH) {
        state.known_route(&id).await?;
    }
    let expected = expected(&state, &headers, &id).await?;
    let deletion = state
        .store
        .delete_route(&id, expected, &by, Timestamp::now());
    match deletion.await? {
        Deleted::Done => {
            state.decisions.forget_map(&id);
            Ok(StatusCode::NO_CONTENT)
        }
        Deleted::NotThere => Err(Problem::unknown_route()),
        Deleted::Stale => Err(stale("route")),
    }
}
