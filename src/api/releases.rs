//! Releasing a version of a map for vehicles, and withdrawing it.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::note::checked_note;
use super::parameters::{RouteParam, VersionParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{VersionReleaseProblems, VersionRetirementProblems};
use super::upload::small_json;
use super::versions::{VersionBody, known_version};
use crate::ids::RouteId;
use crate::model::{Actor, VersionState};
use crate::pipeline::{ReleaseError, ReleaseOrder};
use crate::store::VersionRelease;

/// What goes with a release; an empty body is as good as `{}`.
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
/// Its picture of what was accepted is kept as it is now, with its hash, and never changes; the map goes
/// on as the next version. Waits for the batch that the route is processing. Safe to repeat: a version that is
/// released stays as it is.
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
    headers: HeaderMap,
    body: Body,
) -> Result<Json<VersionBody>, Problem> {
    let post: ReleasePost = small_json(&state, &headers, body).await?;
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
/// It is no longer what `map.png`, `map.pgm` and `map.yaml` of the route answer with; its own files stay.
/// Safe to repeat.
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
        let detail = format!("version {version} is the draft: only a released version is retired");
        return Err(Problem::new(ProblemKind::VersionState, detail));
    }
    Ok(Json(record.into()))
}

fn problem_of(error: ReleaseError) -> Problem {
    match error {
        ReleaseError::UnknownVersion => Problem::not_found("version of the map"),
        ReleaseError::NotAllowed(version) => {
            let detail = format!(
                "version {} has ended: only the draft is released, the last one of the list",
                version.version
            );
            Problem::new(ProblemKind::VersionState, detail)
        }
        ReleaseError::Empty => {
            let detail = "there is no map yet to release: nothing has been merged";
            Problem::new(ProblemKind::VersionState, detail)
        }
        ReleaseError::Busy => {
            let detail = "the route changes too quickly; send the same again later";
            Problem::new(ProblemKind::Overloaded, detail)
        }
        ReleaseError::Store(error) => error.into(),
        error @ ReleaseError::Failed(_) => Problem::internal(error),
    }
}
