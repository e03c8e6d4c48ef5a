//! The trips of a route.

use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, PageQuery};
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::parameters::RouteParam;
use super::problem::Problem;
use super::problem_responses::RouteProblems;
use super::types::timestamp;
use crate::ids::{RouteId, TripId};
use crate::store::TripRecord;

/// A trip: one drive of one vehicle.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Trip)]
struct TripBody {
    /// Its name.
    trip_id: String,
    /// Whose it is.
    vehicle_id: String,
    /// Its batches, whatever became of them.
    batches: i64,
    /// Those of them that are in the map.
    merged_batches: i64,
    /// Scans in its batches.
    scans: i64,
    /// Whether a part of it is in the map.
    localised: bool,
    /// When its first node was taken; null without nodes.
    #[schema(required, value_type = Option<String>, format = DateTime)]
    first_stamp: Option<Timestamp>,
    /// When its last node was taken; null without nodes.
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

/// A part of a route's list of trips.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct TripPage {
    /// By name.
    items: Vec<TripBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for TripPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// List a route's trips.
///
/// Whose they are, what they brought, and whether they are in the map.
#[utoipa::path(
    get, path = "/v1/routes/{route}/trips", tag = "vehicles",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A part of the list", body = TripPage), RouteProblems)
)]
pub(super) async fn list_trips(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<TripPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<TripId> = key_of_cursor(query.cursor.as_deref())?;
    let page = state.store.trip_page(&route_id, after.as_ref(), limit + 1);
    let mut trips = page.await?;
    let next_cursor = cut_page(&mut trips, limit, |trip| trip.id.to_string());
    let items = trips.into_iter().map(TripBody::from).collect();
    Ok(Listed(TripPage { items, next_cursor }))
}
