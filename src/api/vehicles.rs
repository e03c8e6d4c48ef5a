//! The vehicles of a route, and how they are calibrated.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery, PageQuery};
use super::paging::{checked_limit, cut_page, key_of_cursor};
use super::problem::{Problem, ProblemKind};
use crate::calibration::{Quantity, VehicleCalibration};
use crate::ids::{AlertId, RouteId, VehicleId};
use crate::store::VehicleRecord;

/// A vehicle as a route knows it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Vehicle)]
pub(super) struct VehicleBody {
    /// Its name.
    id: String,
    /// Whether what it sends is believed.
    state: VehicleStateName,
    /// Why it is not trusted, for people; empty for one that is.
    reasons: Vec<String>,
    /// Undecided alerts that suspect it.
    #[schema(value_type = Vec<String>)]
    suspected_by: Vec<AlertId>,
    /// What it has sent.
    counts: VehicleCountsBody,
    /// When its last batch arrived.
    #[schema(value_type = String, format = DateTime)]
    last_seen: Timestamp,
    /// Where its lidar truly sits and how its wheels and its clock err, as far as its trips say.
    calibration: CalibrationBody,
}

/// Whether what a vehicle sends is believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = VehicleState)]
#[serde(rename_all = "snake_case")]
enum VehicleStateName {
    /// Nothing speaks against it.
    Trusted,
    /// An undecided alert of kind `vehicle_suspect` names it.
    Suspect,
}

/// What a vehicle has sent.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = VehicleCounts)]
struct VehicleCountsBody {
    /// Its trips.
    trips: i64,
    /// Batches, whatever became of them.
    batches: i64,
    /// Scans in them.
    scans: i64,
}

/// What a vehicle's trips say of its systematic errors.
///
/// Each value is how far the truth is from what was stated: 0 for a vehicle that is as it says. A
/// value is null where no trip tells it: wheels and straight ways tell the yaw of a mount, turns its
/// position. A trip is asked once the map keeps 150 of its scans, and again at 600; the newest 20
/// trips of a vehicle are weighed together.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Calibration)]
struct CalibrationBody {
    /// Trips that were asked.
    trips: usize,
    /// Turn of the lidar on its mount, radians, counter-clockwise.
    #[schema(required)]
    yaw: Option<CalibratedBody>,
    /// How far the lidar sits ahead of its stated mount, metres.
    #[schema(required)]
    offset_x: Option<CalibratedBody>,
    /// How far the lidar sits to the left of its stated mount, metres.
    #[schema(required)]
    offset_y: Option<CalibratedBody>,
    /// Share by which ways by the scans are longer than by the wheels.
    #[schema(required)]
    way_scale: Option<CalibratedBody>,
    /// Share by which turns are larger than the wheels say.
    #[schema(required)]
    turn_scale: Option<CalibratedBody>,
    /// Turn that each metre ahead adds and the wheels do not show, radians a metre.
    #[schema(required)]
    turn_per_metre: Option<CalibratedBody>,
    /// How long after the odometry of the same stamp the scans show a motion, seconds. Whatever is
    /// said here, each trip's odometry is moved by the offset that its own scans show.
    #[schema(required)]
    clock: Option<CalibratedBody>,
    /// Share by which the beams are farther apart than stated, where turns and straight walls agree
    /// on it.
    #[schema(required)]
    beam_spacing: Option<CalibratedBody>,
    /// What the newest trip contradicts of what those before it said: names of the fields above.
    changed: Vec<String>,
    /// Faults of the newest trip that no correction would mend, for people.
    faults: Vec<String>,
}

/// A value with its standard error.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Calibrated)]
struct CalibratedBody {
    /// The value.
    value: f64,
    /// Its standard error.
    sigma: f64,
    /// Whether it is sure enough to be corrected for: three standard errors from 0, known well
    /// enough, and two trips, or both halves of one, agree on it.
    sure: bool,
    /// Whether scans and odometry are corrected by it. None is yet: they are taken as stated.
    applied: bool,
}

/// A part of a route's list of vehicles.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = VehiclePage)]
pub(super) struct VehiclePage {
    /// By name.
    items: Vec<VehicleBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

/// List the vehicles of a route.
///
/// All that ever sent a batch, by name, in parts.
#[utoipa::path(
    get, path = "/v1/routes/{route}/vehicles", tag = "vehicles",
    params(
        ("route" = String, Path, description = "Name of the route", pattern = "^[A-Za-z0-9._-]{1,64}$"),
        PageQuery,
    ),
    responses((status = 200, description = "A part of the list", body = VehiclePage))
)]
pub(super) async fn list_vehicles(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Json<VehiclePage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<VehicleId> = key_of_cursor(query.cursor.as_deref())?;
    state.known_route(&route_id).await?;
    let read = state
        .store
        .vehicle_page(&route_id, after.as_ref(), limit + 1);
    let mut vehicles = read.await?;
    let next_cursor = cut_page(&mut vehicles, limit, |vehicle| vehicle.id.to_string());
    Ok(Json(VehiclePage {
        items: vehicles.into_iter().map(VehicleBody::from).collect(),
        next_cursor,
    }))
}

/// Read a vehicle of a route.
#[utoipa::path(
    get, path = "/v1/routes/{route}/vehicles/{vehicle}", tag = "vehicles",
    params(
        ("route" = String, Path, description = "Name of the route", pattern = "^[A-Za-z0-9._-]{1,64}$"),
        ("vehicle" = String, Path, description = "Name of the vehicle", pattern = "^[A-Za-z0-9._-]{1,64}$"),
    ),
    description = "What it has sent, whether it is suspected, and what its trips say of its calibration.",
    responses((status = 200, description = "The vehicle", body = VehicleBody))
)]
pub(super) async fn get_vehicle(
    State(state): State<ApiState>,
    ApiPath((route_id, vehicle_id)): ApiPath<(RouteId, VehicleId)>,
) -> Result<Json<VehicleBody>, Problem> {
    state.known_route(&route_id).await?;
    let vehicle = state.store.vehicle(&route_id, &vehicle_id).await?;
    let vehicle = vehicle.ok_or_else(|| {
        let detail = format!("route {route_id} has no batch of a vehicle {vehicle_id}");
        Problem::new(ProblemKind::NotFound, detail)
    })?;
    Ok(Json(vehicle.into()))
}

impl From<VehicleRecord> for VehicleBody {
    fn from(vehicle: VehicleRecord) -> Self {
        let state = match vehicle.suspected_by.is_empty() {
            true => VehicleStateName::Trusted,
            false => VehicleStateName::Suspect,
        };
        let reasons = vehicle.suspected_by.iter();
        let reasons = reasons.map(|alert| format!("alert {alert} suspects its lidar"));
        Self {
            id: vehicle.id.to_string(),
            state,
            reasons: reasons.collect(),
            suspected_by: vehicle.suspected_by.clone(),
            counts: VehicleCountsBody {
                trips: vehicle.trips,
                batches: vehicle.batches,
                scans: vehicle.scans,
            },
            last_seen: vehicle.last_seen,
            calibration: vehicle.into(),
        }
    }
}

impl From<VehicleRecord> for CalibrationBody {
    fn from(vehicle: VehicleRecord) -> Self {
        let trips = vehicle.calibrations.len();
        let calibration = vehicle
            .calibrations
            .into_iter()
            .fold(VehicleCalibration::default(), |before, trip| {
                before.with_trip(trip)
            });
        let calibrated = |quantity: Quantity| {
            let combined = calibration.combined(quantity)?;
            Some(CalibratedBody {
                value: combined.estimate.value,
                sigma: combined.estimate.sigma,
                sure: calibration.applied().contains_key(&quantity),
                applied: false,
            })
        };
        let changed = calibration.changed().iter();
        let changed = changed.filter_map(|change| field_of(change.quantity));
        Self {
            trips,
            yaw: calibrated(Quantity::MountYaw),
            offset_x: calibrated(Quantity::MountX),
            offset_y: calibrated(Quantity::MountY),
            way_scale: calibrated(Quantity::WayScale),
            turn_scale: calibrated(Quantity::TurnScale),
            turn_per_metre: calibrated(Quantity::TurnPerMetre),
            clock: calibrated(Quantity::ClockOffset),
            beam_spacing: calibrated(Quantity::BeamSpacing),
            changed: changed.map(str::to_owned).collect(),
            faults: calibration.uncorrectable().to_vec(),
        }
    }
}

/// The field that a quantity stands in; the scale of the ranges is not told by a vehicle alone.
fn field_of(quantity: Quantity) -> Option<&'static str> {
    Some(match quantity {
        Quantity::MountYaw => "yaw",
        Quantity::MountX => "offset_x",
        Quantity::MountY => "offset_y",
        Quantity::WayScale => "way_scale",
        Quantity::TurnScale => "turn_scale",
        Quantity::TurnPerMetre => "turn_per_metre",
        Quantity::ClockOffset => "clock",
        Quantity::BeamSpacing => "beam_spacing",
        Quantity::RangeScale => return None,
    })
}
