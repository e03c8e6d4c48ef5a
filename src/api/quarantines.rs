//! Keeping what a vehicle sends out of a map, by hand.

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
use super::parameters::{RouteParam, VehicleParam};
use super::problem::Problem;
use super::problem_responses::{QuarantineProblems, ReleaseProblems};
use super::upload::small_json;
use super::vehicles::{VehicleBody, known_vehicle};
use crate::ids::{RouteId, VehicleId};
use crate::model::Actor;
use crate::store::Quarantine;

/// What goes with it; an empty body is as good as `{}`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"note": "its mount is loose"}))]
pub(super) struct QuarantinePost {
    /// Why, for people: stands among the vehicle's reasons, and as the `reason` of its batches.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
}

/// Keep a vehicle's uploads out of the map.
///
/// From now on, until it is released: they are taken on and kept, and end as `quarantined`, those among
/// them that wait already. What is in the map stays there; a removal takes it out. Safe to repeat: the
/// first note stays.
#[utoipa::path(
    post, path = "/v1/routes/{route}/vehicles/{vehicle}/quarantine", tag = "vehicles",
    params(RouteParam, VehicleParam),
    request_body(content = QuarantinePost, description = "Why"),
    responses((status = 200, description = "The vehicle", body = VehicleBody), QuarantineProblems)
)]
pub(super) async fn quarantine_vehicle(
    State(state): State<ApiState>,
    ApiPath((route, vehicle)): ApiPath<(RouteId, VehicleId)>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<VehicleBody>, Problem> {
    let post: QuarantinePost = small_json(&state, &headers, body).await?;
    let quarantine = Quarantine {
        since: Timestamp::now(),
        note: checked_note(post.note)?,
    };
    put(&state, &route, &vehicle, Some(quarantine), &by).await
}

/// Release a vehicle.
///
/// What it sends from now on goes into the map again; what was kept out meanwhile can be tried again,
/// batch by batch. A vehicle that is merely suspected is released by deciding about the alerts that
/// suspect it, or by itself once it drives well.
#[utoipa::path(
    post, path = "/v1/routes/{route}/vehicles/{vehicle}/release", tag = "vehicles",
    params(RouteParam, VehicleParam),
    responses((status = 200, description = "The vehicle", body = VehicleBody), ReleaseProblems)
)]
pub(super) async fn release_vehicle(
    State(state): State<ApiState>,
    ApiPath((route, vehicle)): ApiPath<(RouteId, VehicleId)>,
    _: NoQuery,
    by: Actor,
) -> Result<Json<VehicleBody>, Problem> {
    put(&state, &route, &vehicle, None, &by).await
}

async fn put(
    state: &ApiState,
    route: &RouteId,
    vehicle: &VehicleId,
    quarantine: Option<Quarantine>,
    by: &Actor,
) -> Result<Json<VehicleBody>, Problem> {
    // One that is not there is the problem of reading it.
    state
        .store
        .put_quarantine(route, vehicle, quarantine, by, Timestamp::now())
        .await?;
    known_vehicle(state, route, vehicle).await
}
