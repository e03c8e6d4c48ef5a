//! Versions of a route's map.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::paging::{Listed, PageQuery, page};
use super::parameters::{RouteParam, VersionParam};
use super::problem::Problem;
use super::problem_responses::{RoutePartProblems, RouteProblems};
use super::types::hex;
use crate::ids::{AlertId, RouteId};
use crate::model::{VersionAction, VersionState};
use crate::store::{MapVersionRecord, VersionRelease};

/// A version of a route's map.
///
/// A version begins as the draft, which grows with every batch. It ends when a change is accepted, when an
/// acceptance is undone, or when it is released; the map continues as the next version. The picture of a version
/// that has ended never changes.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersion)]
pub(super) struct VersionBody {
    /// 1 for the first map; increases with every accepted change, undo and release.
    version: i64,
    /// The epoch that it belongs to: increases with every accepted change and undo.
    epoch: i64,
    /// Whether it is the draft, released or retired. A version that ended without a release is `retired`.
    state: VersionState,
    /// Whether new passes are compared with it: true for the draft only.
    current: bool,
    /// When the version began.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// When the next version followed; null for the draft.
    #[schema(required, value_type = Option<String>, format = DateTime)]
    superseded_at: Option<Timestamp>,
    /// What began it; null for the first version.
    #[schema(required)]
    cause: Option<VersionCauseBody>,
    /// The largest displacement of a node when it began, against the version before, metres: 0 after a release.
    /// The map's first node never moves. Null if it was not measured.
    #[schema(required)]
    max_displacement_m: Option<f64>,
    /// Its release for vehicles; null if it was never released.
    #[schema(required)]
    released: Option<VersionReleaseBody>,
    /// When it was retired after its release; null otherwise.
    #[schema(required, value_type = Option<String>, format = DateTime)]
    retired_at: Option<Timestamp>,
    /// The SHA-256 of its `map.pgm`, hexadecimal, which never changes; null for the draft.
    #[schema(required, min_length = 64, max_length = 64)]
    sha256: Option<String>,
}

/// What began a version.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersionCause)]
struct VersionCauseBody {
    /// The alert that was accepted or undone; null for a release.
    #[schema(required, value_type = Option<String>, format = "uuid")]
    alert_id: Option<AlertId>,
    /// What was done.
    action: VersionAction,
    /// Who did it; null if that was not recorded.
    #[schema(required)]
    by: Option<String>,
    /// Why, for people.
    #[schema(required)]
    note: Option<String>,
}

/// A version's release for vehicles.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MapVersionRelease)]
struct VersionReleaseBody {
    /// When it was released.
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// Who released it.
    by: String,
    /// Why, for people.
    #[schema(required)]
    note: Option<String>,
}

page! {
    /// A page of the list of versions.
    #[schema(as = MapVersionPage)]
    pub(super) struct VersionPage {
        /// The oldest first.
        items: Vec<VersionBody>,
    }
}

/// List the versions of a route's map.
///
/// A version begins when a change of the world is accepted, when an acceptance is undone, or when the version
/// before is released. The last one is the draft.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions", tag = "map",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A page of the list", body = VersionPage), RouteProblems)
)]
pub(super) async fn list_versions(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<VersionPage>, Problem> {
    let wanted = query.wanted::<i64>()?;
    let after = wanted.after.unwrap_or_default();
    let records = state.store.map_versions(&route_id, after, wanted.to_read());
    Ok(wanted.page(records.await?, |record| record.version, VersionBody::from))
}

/// Read a version of a route's map.
///
/// Its state, what began it, and the hash of its picture.
#[utoipa::path(
    get, path = "/v1/routes/{route}/versions/{version}", tag = "map",
    params(RouteParam, VersionParam),
    responses((status = 200, description = "The version", body = VersionBody), RoutePartProblems)
)]
pub(super) async fn get_version(
    State(state): State<ApiState>,
    ApiPath((route_id, version)): ApiPath<(RouteId, i64)>,
    _: NoQuery,
) -> Result<Json<VersionBody>, Problem> {
    let record = known_version(&state, &route_id, version).await?;
    Ok(Json(record.into()))
}

/// A version of a route's map.
///
/// # Errors
/// The [`Problem`] that there is none.
pub(super) async fn known_version(
    state: &ApiState,
    route_id: &RouteId,
    version: i64,
) -> Result<MapVersionRecord, Problem> {
    let record = state.store.map_version(route_id, version).await?;
    record.ok_or_else(|| Problem::not_found("version of the map"))
}

impl From<MapVersionRecord> for VersionBody {
    fn from(record: MapVersionRecord) -> Self {
        Self {
            version: record.version,
            epoch: record.epoch,
            state: record.state(),
            current: record.superseded_at.is_none(),
            created_at: record.created_at,
            superseded_at: record.superseded_at,
            cause: record.cause.map(|cause| VersionCauseBody {
                alert_id: cause.alert_id,
                action: cause.action,
                by: cause.by,
                note: cause.note,
            }),
            max_displacement_m: record.max_displacement_m,
            released: record.released.map(VersionReleaseBody::from),
            retired_at: record.retired_at,
            sha256: record.sha256.map(|bytes| hex(&bytes)),
        }
    }
}

impl From<VersionRelease> for VersionReleaseBody {
    fn from(release: VersionRelease) -> Self {
        Self {
            at: release.at,
            by: release.by,
            note: release.note,
        }
    }
}
