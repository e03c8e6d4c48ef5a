//! Releasing a version of a map for vehicles, and withdrawing it.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::note::checked_note;
use super::parameters::{RouteParam, VersionParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{VersionReleaseProblems, VersionRetirementProblems};
use super::upload::SmallJson;
use super::versions::{VersionBody, known_version};
use crate::ids::RouteId;
use crate::model::{Actor, VersionState};
use crate::pipeline::{ReleaseError, ReleaseOrder};
use crate::store::VersionRelease;

/// The details of a release; an empty body counts as `{}`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"note": "after the move of aisle 4"}))]
pub(super) struct ReleasePost {
    /// Why, for people.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
}

/// Release the draft of a map for vehicles.
///
/// The picture of the accepted map is stored with its hash and never changes; the map continues as the next
/// version. Waits for the batch that the route is processing. Safe to repeat: a released version does not
/// change.
#[utoipa::path(
    post, path = "/v1/routes/{route}/versions/{version}/release", tag = "map",
    params(RouteParam, VersionParam),
    request_body(content = ReleasePost, description = "Why"),
    responses((status = 200, description = "The released version", body = VersionBody), VersionReleaseProblems)
)]
pub(super) async fn release_version(
    State(state): State<ApiState>,
    ApiPath((route_id, version)): ApiPath<(RouteId, i64)>,
    _: NoQuery,
    actor: Actor,
    SmallJson(post): SmallJson<ReleasePost>,
) -> Result<Json<VersionBody>, Problem> {
    let note = checked_note(post.note)?;
    let order = ReleaseOrder {
        route_id,
        version,
        release: VersionRelease {
            at: Timestamp::now(),
            by: actor.name().to_owned(),
            note,
        },
        actor,
    };
    let released = state.decisions.release(order).await.map_err(problem_of)?;
    Ok(Json(released.into()))
}

/// Retire a released version of a map.
///
/// The route's `map.png`, `map.pgm` and `map.yaml` no longer show it; its own files remain. Safe to repeat.
#[utoipa::path(
    post, path = "/v1/routes/{route}/versions/{version}/retire", tag = "map",
    params(RouteParam, VersionParam),
    responses((status = 200, description = "The retired version", body = VersionBody), VersionRetirementProblems)
)]
pub(super) async fn retire_version(
    State(state): State<ApiState>,
    ApiPath((route_id, version)): ApiPath<(RouteId, i64)>,
    _: NoQuery,
    actor: Actor,
) -> Result<Json<VersionBody>, Problem> {
    let now = Timestamp::now();
    let retired = state.store.retire_version(&route_id, version, &actor, now);
    retired.await?;
    let record = known_version(&state, &route_id, version).await?;
    if record.state() == VersionState::Draft {
        let detail =
            format!("version {version} is the draft: only a released version can be retired");
        return Err(Problem::new(ProblemKind::VersionState, detail));
    }
    Ok(Json(record.into()))
}

fn problem_of(error: ReleaseError) -> Problem {
    match error {
        ReleaseError::UnknownVersion => Problem::not_found("version of the map"),
        ReleaseError::NotAllowed(version) => {
            let detail = format!(
                "version {} has ended: only the draft, the last version of the list, can be released",
                version.version
            );
            Problem::new(ProblemKind::VersionState, detail)
        }
        ReleaseError::Empty => {
            let detail = "there is no map to release yet: nothing has been merged";
            Problem::new(ProblemKind::VersionState, detail)
        }
        ReleaseError::Busy => {
            let detail = "the route is changing too quickly; send the same again later";
            Problem::new(ProblemKind::Overloaded, detail)
        }
        ReleaseError::Store(error) => error.into(),
        error @ ReleaseError::Failed(_) => Problem::internal(error),
    }
}
