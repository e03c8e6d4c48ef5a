//! Versions of a route's map.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, PageQuery};
use super::paging::{checked_limit, key_of_cursor};
use super::problem::Problem;
use crate::ids::RouteId;

/// A version of a route's map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersion)]
struct VersionBody {
    /// 1 for the first map; raised by every accepted change.
    version: i64,
    /// The epoch that it belongs to.
    epoch: i64,
    /// Whether new laps are compared with it.
    current: bool,
    /// When the version began.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

/// A part of the list of versions.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersionPage)]
pub(super) struct VersionPage {
    /// The oldest first.
    items: Vec<VersionBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

/// List the versions of a route's map.
///
/// A version begins when a change of the world is accepted. Every route has one version now.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions", tag = "map",
    params(
        ("route" = String, Path, description = "Name of the route", pattern = "^[A-Za-z0-9._-]{1,64}$"),
        PageQuery,
    ),
    responses((status = 200, description = "A part of the list", body = VersionPage))
)]
pub(super) async fn list_versions(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Json<VersionPage>, Problem> {
    checked_limit(query.limit)?;
    let after: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    let route = state.known_route(&route_id).await?;
    let current = VersionBody {
        version: route.map_version,
        epoch: route.epoch,
        current: true,
        created_at: route.created_at,
    };
    let items = [current].into_iter();
    Ok(Json(VersionPage {
        items: items
            .filter(|item| after.is_none_or(|after| item.version > after))
            .collect(),
        next_cursor: None,
    }))
}
