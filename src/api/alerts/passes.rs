//! The passes by an alert's place.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::known::known_alert;
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::parameters::AlertParam;
use crate::api::problem::Problem;
use crate::api::problem_responses::AlertProblems;
use crate::api::types::timestamp;
use crate::change::{JudgedPass, JudgedPasses, PassCounts};
use crate::ids::AlertId;
use crate::model::{PassOutcome, PassSide};

/// How many passes observed what at an alert's place.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertPassCounts)]
pub(super) struct PassCountsBody {
    /// The passes before the first observation of the new state, as far as their scans are still in the map,
    /// which keeps three old ones of every place.
    before: OutcomeCounts,
    /// The passes since.
    since: OutcomeCounts,
}

/// The number of passes with each outcome.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = PassOutcomeCounts)]
struct OutcomeCounts {
    /// Observed free space at the place.
    saw_free: u32,
    /// Observed an object at the place.
    saw_occupied: u32,
    /// Came within reach, but the place was hidden or their scans disagree.
    could_not_see: u32,
}

/// The passes by an alert's place.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api) struct AlertPassPage {
    /// The oldest first; if there are more than 200, the first and the newest ones.
    #[schema(max_items = 200)]
    items: Vec<AlertPassBody>,
    /// Always null: all passes are in one answer.
    #[schema(required)]
    next_cursor: Option<String>,
}

/// A pass by an alert's place: an uninterrupted part of a trip in which the place is within reach of the
/// lidar. A new one begins after 30 s out of reach, or after 2 minutes within reach.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertPass)]
struct AlertPassBody {
    /// The trip that it is a part of.
    trip_id: String,
    /// The vehicle.
    vehicle_id: String,
    /// The first of its observations that covers the place; for a pass that could not see it, the first within
    /// reach.
    #[schema(value_type = String, format = DateTime)]
    begins_at: Timestamp,
    /// The last such observation.
    #[schema(value_type = String, format = DateTime)]
    ends_at: Timestamp,
    /// Whether it was before the change or since.
    side: PassSide,
    /// What it observed.
    outcome: PassOutcome,
    /// The keyframe whose scan, or a scan that follows it, shows this best.
    node_id: i64,
}

/// List the passes by an alert's place.
///
/// Whether each pass observed the old state, the new one, or neither. Empty for alerts that are not about the
/// change of a place, and for old ones, not updated since the service began to record passes.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}/passes", tag = "alerts",
    params(AlertParam),
    responses((status = 200, description = "The passes", body = AlertPassPage), AlertProblems)
)]
pub(in crate::api) async fn list_alert_passes(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
) -> Result<Json<AlertPassPage>, Problem> {
    let alert = known_alert(&state, id).await?;
    let passes = alert.passes.map(|passes| passes.listed).unwrap_or_default();
    Ok(Json(AlertPassPage {
        items: passes.into_iter().map(AlertPassBody::from).collect(),
        next_cursor: None,
    }))
}

impl From<&JudgedPasses> for PassCountsBody {
    fn from(passes: &JudgedPasses) -> Self {
        Self {
            before: passes.before.into(),
            since: passes.since.into(),
        }
    }
}

impl From<PassCounts> for OutcomeCounts {
    fn from(counts: PassCounts) -> Self {
        Self {
            saw_free: counts.saw_free,
            saw_occupied: counts.saw_occupied,
            could_not_see: counts.could_not_see,
        }
    }
}

impl From<JudgedPass> for AlertPassBody {
    fn from(pass: JudgedPass) -> Self {
        Self {
            trip_id: pass.trip.to_string(),
            vehicle_id: pass.vehicle.to_string(),
            begins_at: timestamp(pass.begins),
            ends_at: timestamp(pass.ends),
            side: pass.side,
            outcome: pass.outcome,
            node_id: pass.node.0,
        }
    }
}
