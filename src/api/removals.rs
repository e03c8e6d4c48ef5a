//! Removing uploads from a route.

use axum::extract::State;
use axum::response::Response;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::note::checked_note;
use super::operation::{OperationBody, accepted};
use super::parameters::RouteParam;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RemovalProblems;
use super::types::NameText;
use super::upload::SmallJson;
use crate::ids::{BatchId, RouteId, TripId, VehicleId};
use crate::model::Actor;
use crate::store::{Meant, OperationRequest, RemovalRequest};

const NAMES_MAX: usize = 1_000;

/// What to remove: exactly one of `batches`, `trips` and `vehicle_id`.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"trips": ["agv-07-0931"], "note": "its lidar was loose"}))]
pub(super) struct RemovalPost {
    /// Ids of batches.
    #[schema(min_items = 1, max_items = 1000, value_type = Option<Vec<NameText>>)]
    batches: Option<Vec<BatchId>>,
    /// Names of trips, all of whose batches are removed.
    #[schema(min_items = 1, max_items = 1000, value_type = Option<Vec<NameText>>)]
    trips: Option<Vec<TripId>>,
    /// A vehicle, all of whose batches are removed.
    #[schema(value_type = Option<String>, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: Option<VehicleId>,
    /// Only batches that arrived at this time or later; only with `vehicle_id`.
    #[schema(value_type = Option<String>, format = DateTime)]
    since: Option<Timestamp>,
    /// Only report what would be removed; false by default.
    dry_run: Option<bool>,
    /// Also delete the bytes of the uploads, permanently; false by default.
    erase: Option<bool>,
    /// Why, for people: shown as the `reason` of the batches.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
}

impl RemovalPost {
    fn check(self) -> Result<RemovalRequest, Problem> {
        let refuse = |pointer: &str, detail: &str| {
            Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer))
        };
        if self.since.is_some() && self.vehicle_id.is_none() {
            return refuse("/since", "a time goes with vehicle_id only");
        }
        let is_count = |count: usize| (1..=NAMES_MAX).contains(&count);
        if self
            .batches
            .as_ref()
            .is_some_and(|names| !is_count(names.len()))
        {
            return refuse("/batches", "name 1 to 1,000 batches");
        }
        if self
            .trips
            .as_ref()
            .is_some_and(|names| !is_count(names.len()))
        {
            return refuse("/trips", "name 1 to 1,000 trips");
        }
        let meant = match (self.batches, self.trips, self.vehicle_id) {
            (Some(batches), None, None) => Meant::Batches(batches),
            (None, Some(trips), None) => Meant::Trips(trips),
            (None, None, Some(id)) => Meant::Vehicle {
                id,
                since: self.since,
            },
            _ => return refuse("", "give exactly one of batches, trips and vehicle_id"),
        };
        Ok(RemovalRequest {
            meant,
            dry_run: self.dry_run.unwrap_or(false),
            erase: self.erase.unwrap_or(false),
            note: checked_note(self.note)?,
        })
    }
}

/// Remove uploads from a route.
///
/// From the map, alerts and pictures: their nodes and edges are deleted at once, the rest of the map is optimised
/// again, and every place is judged again. Then the route is processed again as if they had never been uploaded, and
/// its map replaced by what comes of it, decisions included; meanwhile the route is used as before. This takes as long
/// as processing its uploads did. The uploads remain in the list of batches as `removed`, and their bytes are kept
/// unless `erase` is set. Safe to repeat: what was removed before is skipped. The answer names an operation, which
/// shows the progress; it continues after a restart of the service.
#[utoipa::path(
    post, path = "/v1/routes/{route}/removals", tag = "batches",
    params(RouteParam),
    request_body(content = RemovalPost, description = "What to remove"),
    responses(
        (status = 202, description = "It will be carried out", body = OperationBody, headers(("Location" = String, description = "The operation"))),
        RemovalProblems,
    )
)]
pub(super) async fn post_removal(
    State(state): State<ApiState>,
    ApiPath(route): ApiPath<RouteId>,
    _: NoQuery,
    by: Actor,
    SmallJson(post): SmallJson<RemovalPost>,
) -> Result<Response, Problem> {
    let request = OperationRequest::Removal(post.check()?);
    let id = state.operations.ask_for(Some(&route), request, &by).await?;
    accepted(&state, id).await
}
