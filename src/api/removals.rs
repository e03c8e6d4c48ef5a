//! Taking uploads out of a route.

use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::note::checked_note;
use super::operation::{OperationBody, taken_on};
use super::parameters::RouteParam;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RemovalProblems;
use super::types::NameText;
use super::upload::small_json;
use crate::ids::{BatchId, RouteId, TripId, VehicleId};
use crate::model::Actor;
use crate::store::{Meant, OperationRequest, RemovalRequest};

const NAMES_MAX: usize = 1_000;

/// What to take out: exactly one of `batches`, `trips` and `vehicle_id`.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"trips": ["agv-07-0931"], "note": "its lidar was loose"}))]
pub(super) struct RemovalPost {
    /// Batches by their ids.
    #[schema(min_items = 1, max_items = 1000, value_type = Option<Vec<NameText>>)]
    batches: Option<Vec<BatchId>>,
    /// Everything of some trips.
    #[schema(min_items = 1, max_items = 1000, value_type = Option<Vec<NameText>>)]
    trips: Option<Vec<TripId>>,
    /// Everything that a vehicle sent …
    #[schema(value_type = Option<String>, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: Option<VehicleId>,
    /// … and that came in at this time or later; only with `vehicle_id`.
    #[schema(value_type = Option<String>, format = DateTime)]
    since: Option<Timestamp>,
    /// Only say what would be removed; false if left out.
    dry_run: Option<bool>,
    /// Delete the bytes of the uploads too, for good; false if left out.
    erase: Option<bool>,
    /// Why, for people: stands as the `reason` of the batches.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
}

impl RemovalPost {
    fn check(self) -> Result<RemovalRequest, Problem> {
        let refuse = |pointer: &str, detail: &str| {
            Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer))
        };
        if self.since.is_some() && self.vehicle_id.is_none() {
            return refuse("/since", "a time goes with vehicle_id alone");
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

/// Take uploads out of a route.
///
/// Out of the map, of alerts and of pictures: their nodes and edges go, the rest of the map is solved
/// anew, and every place is judged anew. The uploads stay in the list of batches as `removed`, and their
/// bytes are kept unless `erase` says otherwise. What nothing ties to the rest any more stays where it
/// is. Safe to repeat: what was removed before is passed over. The answer names an operation, which says
/// how far it has come; it goes on if the service is restarted meanwhile.
#[utoipa::path(
    post, path = "/v1/routes/{route}/removals", tag = "batches",
    params(RouteParam),
    request_body(content = RemovalPost, description = "What to take out"),
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
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let post: RemovalPost = small_json(&state, &headers, body).await?;
    let request = OperationRequest::Removal(post.check()?);
    let id = state.operations.ask_for(Some(&route), request, &by).await?;
    taken_on(&state, id).await
}
