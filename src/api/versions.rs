//! Versions of a route's map.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::Schema;
use utoipa::{PartialSchema, ToSchema};

use super::ApiState;
use super::enum_schemas::one_of;
use super::extract::{ApiPath, ApiQuery, PageQuery};
use super::paging::{checked_limit, cut_page, key_of_cursor};
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RouteProblems;
use crate::ids::{AlertId, RouteId};
use crate::model::AlertAction;
use crate::store::MapVersionRecord;

/// A version of a route's map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersion)]
struct VersionBody {
    /// 1 for the first map; raised by every accepted change and by every undo.
    version: i64,
    /// The epoch that it belongs to.
    epoch: i64,
    /// Whether new laps are compared with it.
    current: bool,
    /// When the version began.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// When another version followed; null for the present one.
    #[schema(required, value_type = Option<String>, format = DateTime)]
    superseded_at: Option<Timestamp>,
    /// The decision that began it; null for the first version.
    #[schema(required)]
    cause: Option<VersionCauseBody>,
    /// SHA-256 of its `map.pgm`, hexadecimal, which never changes; null for the present version,
    /// whose map grows with every batch.
    #[schema(required, min_length = 64, max_length = 64)]
    sha256: Option<String>,
}

/// The decision that began a version.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersionCause)]
struct VersionCauseBody {
    /// About which alert.
    #[schema(value_type = String, format = "uuid")]
    alert_id: AlertId,
    /// What was decided.
    #[schema(value_type = MapVersionAction)]
    action: AlertAction,
}

/// What begins a version: some of the actions.
enum MapVersionAction {}

impl PartialSchema for MapVersionAction {
    fn schema() -> RefOr<Schema> {
        let actions = [AlertAction::Accept, AlertAction::Undo];
        one_of(actions.map(AlertAction::name), "What begins a version.")
    }
}

impl ToSchema for MapVersionAction {}

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
/// A version begins when a change of the world is accepted, or when that is undone.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions", tag = "map",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A part of the list", body = VersionPage), RouteProblems)
)]
pub(super) async fn list_versions(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Json<VersionPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    state.known_route(&route_id).await?;
    let after = after.unwrap_or_default();
    let mut records = state
        .store
        .map_versions(&route_id, after, limit.saturating_add(1))
        .await?;
    let next_cursor = cut_page(&mut records, limit, |record| record.version.to_string());
    let items = records.iter().map(body).collect();
    Ok(Json(VersionPage { items, next_cursor }))
}

fn body(record: &MapVersionRecord) -> VersionBody {
    VersionBody {
        version: record.version,
        epoch: record.epoch,
        current: record.superseded_at.is_none(),
        created_at: record.created_at,
        superseded_at: record.superseded_at,
        cause: record.cause.as_ref().map(|cause| VersionCauseBody {
            alert_id: cause.alert_id,
            action: cause.action,
        }),
        sha256: (record.sha256)
            .map(|bytes| bytes.iter().map(|byte| format!("{byte:02x}")).collect()),
    }
}
