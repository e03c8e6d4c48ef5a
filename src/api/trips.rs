//! The trips of a route.

use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::paging::{Listed, PageQuery, page};
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RouteProblems;
use super::types::timestamp;
use crate::ids::{RouteId, TripId};
use crate::store::TripRecord;

/// A trip: a part of a vehicle's journey with one odometry frame.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Trip)]
pub(super) struct TripBody {
    /// Its name.
    trip_id: String,
    /// Its vehicle.
    vehicle_id: String,
    /// Its batches, whatever their status.
    batches: i64,
    /// Its batches that are in the map.
    merged_batches: i64,
    /// Scans in its batches.
    scans: i64,
    /// Whether any of its batches is in the map.
    localised: bool,
    /// The stamp of its first node; null without nodes.
    #[schema(required, value_type = Option<String>, format = DateTime)]
    first_stamp: Option<Timestamp>,
    /// The stamp of its last node; null without nodes.
    #[schema(required, value_type = Option<String>, format = DateTime)]
    last_stamp: Option<Timestamp>,
    /// When its first batch arrived.
    #[schema(value_type = String, format = DateTime)]
    first_received_at: Timestamp,
    /// When its last batch arrived.
    #[schema(value_type = String, format = DateTime)]
    last_received_at: Timestamp,
}

impl From<TripRecord> for TripBody {
    fn from(trip: TripRecord) -> Self {
        Self {
            trip_id: trip.id.to_string(),
            vehicle_id: trip.vehicle_id.to_string(),
            batches: trip.batches,
            merged_batches: trip.merged,
            scans: trip.scans,
            localised: trip.merged > 0,
            first_stamp: trip.stamps.map(|(first, _)| timestamp(first)),
            last_stamp: trip.stamps.map(|(_, last)| timestamp(last)),
            first_received_at: trip.first_received_at,
            last_received_at: trip.last_received_at,
        }
    }
}

page! {
    /// A page of a route's list of trips.
    pub(super) struct TripPage {
        /// By name.
        items: Vec<TripBody>,
    }
}

/// List a route's trips.
///
/// By name, each with its vehicle, its uploads, and whether it is in the map.
#[utoipa::path(
    get, path = "/v1/routes/{route}/trips", tag = "vehicles",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A page of the list", body = TripPage), RouteProblems)
)]
pub(super) async fn list_trips(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<TripPage>, Problem> {
    let wanted = query.wanted::<TripId>()?;
    let trips = state
        .store
        .trip_page(&route_id, wanted.after.as_ref(), wanted.to_read());
    Ok(wanted.page(trips.await?, |trip| trip.id.clone(), TripBody::from))
}
