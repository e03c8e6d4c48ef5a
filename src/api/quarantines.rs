//! Keeping a vehicle's uploads out of a map by hand.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::note::checked_note;
use super::parameters::{RouteParam, VehicleParam};
use super::problem::Problem;
use super::problem_responses::{QuarantineProblems, ReleaseProblems};
use super::upload::SmallJson;
use super::vehicles::{VehicleBody, known_vehicle};
use crate::ids::{RouteId, VehicleId};
use crate::model::Actor;
use crate::store::Quarantine;

/// The details of a quarantine; an empty body counts as `{}`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"note": "its mount is loose"}))]
pub(super) struct QuarantinePost {
    /// Why, for people: shown among the vehicle's reasons, and as the `reason` of its batches.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
}

/// Keep a vehicle's uploads out of the map.
///
/// Until the vehicle is released, its uploads are stored but become `quarantined`, including those that are
/// waiting to be processed. What is already in the map remains; a removal takes it out. Safe to repeat: the first
/// note is kept.
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
    SmallJson(post): SmallJson<QuarantinePost>,
) -> Result<Json<VehicleBody>, Problem> {
    let quarantine = Quarantine {
        since: Timestamp::now(),
        note: checked_note(post.note)?,
    };
    put(&state, &route, &vehicle, Some(quarantine), &by).await
}

/// Release a vehicle.
///
/// Its new uploads go into the map again; batches kept out in the meantime can be tried again one by one. A
/// vehicle that is only suspect ceases to be when the alerts that suspect it are decided, or once its trips fit
/// the map again.
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
    // Reading the vehicle reports one that does not exist.
    state
        .store
        .put_quarantine(route, vehicle, quarantine, by, Timestamp::now())
        .await?;
    known_vehicle(state, route, vehicle).await
}
