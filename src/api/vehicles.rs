//! The vehicles of a route, and how they are calibrated.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::paging::{Listed, PageQuery, page};
use super::parameters::{RouteParam, VehicleParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{RoutePartProblems, RouteProblems};
use super::types::timestamp;
use crate::calibration::{
    AppliedCorrection, CalibratedTrip, Quantity, TripCorrections, VehicleCalibration,
};
use crate::ids::{AlertId, LidarId, RouteId, VehicleId};
use crate::model::VehicleState;
use crate::store::{KeptOut, LidarRecord, VehicleRecord};

/// A vehicle on a route.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Vehicle)]
pub(super) struct VehicleBody {
    /// Its name.
    id: String,
    /// The route.
    route_id: String,
    /// Whether its uploads are trusted.
    state: VehicleState,
    /// Why it is not trusted, for people; empty if it is.
    reasons: Vec<String>,
    /// Ids of undecided alerts that suspect it.
    #[schema(value_type = Vec<String>)]
    suspected_by: Vec<AlertId>,
    /// What it has sent.
    counts: VehicleCountsBody,
    /// When its last batch arrived.
    #[schema(value_type = String, format = DateTime)]
    last_seen: Timestamp,
    /// The true mount of its lidar, and the errors of its wheels and its clock, as estimated from its trips. For a
    /// vehicle with several lidars see `lidars`.
    calibration: CalibrationBody,
    /// The same for each of several lidars, by name; empty for a vehicle with only one.
    lidars: Vec<VehicleLidarBody>,
}

/// One of several lidars of a vehicle.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = VehicleLidar)]
struct VehicleLidarBody {
    /// As the vehicle names it.
    id: String,
    /// Estimated from its own scans and the vehicle's odometry.
    calibration: CalibrationBody,
    /// Its mount relative to the lidar that takes the keyframes, estimated from what both observe of the same places;
    /// null before the first estimate. It is not used for corrections.
    #[schema(required)]
    relative_mount: Option<RelativeMountBody>,
}

/// How far a lidar is from its stated mount, assuming that the stated mount of the lidar that takes the keyframes
/// is right. A value is null if no trip determines it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = RelativeMount)]
struct RelativeMountBody {
    /// The number of trips used for the estimate.
    trips: usize,
    /// Rotation of the lidar against its stated mount, radians, counter-clockwise.
    #[schema(required)]
    yaw: Option<CalibratedBody>,
    /// How far the lidar is ahead of its stated mount, metres.
    #[schema(required)]
    offset_x: Option<CalibratedBody>,
    /// How far the lidar is to the left of its stated mount, metres.
    #[schema(required)]
    offset_y: Option<CalibratedBody>,
    /// The fields above whose value the newest trips contradict, until four of them agree on a new one.
    changed: Vec<String>,
}

/// What a vehicle has sent.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = VehicleCounts)]
struct VehicleCountsBody {
    /// Its trips.
    trips: i64,
    /// Its batches, whatever their status.
    batches: i64,
    /// Scans in them.
    scans: i64,
}

/// A vehicle's systematic errors, estimated from its trips.
///
/// Each value is the difference between the true and the stated quantity: 0 for a vehicle that is as stated. A
/// value is null if no trip determines it: straight driving determines the yaw of a mount, turns its position. A
/// trip is used once the map keeps 150 of its scans, and again at 600; the newest 20 trips of a vehicle are
/// combined.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Calibration)]
struct CalibrationBody {
    /// The number of trips used for the estimate.
    trips: usize,
    /// Rotation of the lidar against its stated mount, radians, counter-clockwise.
    #[schema(required)]
    yaw: Option<CalibratedBody>,
    /// How far the lidar is ahead of its stated mount, metres.
    #[schema(required)]
    offset_x: Option<CalibratedBody>,
    /// How far the lidar is to the left of its stated mount, metres.
    #[schema(required)]
    offset_y: Option<CalibratedBody>,
    /// The fraction by which distances from the scans are longer than from the wheels.
    #[schema(required)]
    way_scale: Option<CalibratedBody>,
    /// The fraction by which turns are larger than the wheels say.
    #[schema(required)]
    turn_scale: Option<CalibratedBody>,
    /// Rotation per metre driven ahead that the wheels do not show, radians a metre.
    #[schema(required)]
    turn_per_metre: Option<CalibratedBody>,
    /// How long after the odometry of the same stamp the scans show a motion, seconds. Each trip's odometry is
    /// shifted by the offset that its own scans show, regardless of this value.
    #[schema(required)]
    clock: Option<CalibratedBody>,
    /// Share by which the beams are farther apart than stated, where turns and straight walls agree
    /// on it.
    #[schema(required)]
    beam_spacing: Option<CalibratedBody>,
    /// Share by which distances are longer than the ranges say, beside what other vehicles have
    /// brought into the map. A vehicle alone cannot tell it.
    #[schema(required)]
    range_scale: Option<CalibratedBody>,
    /// The fields above whose value the newest trips contradict, until four of them agree on a new one.
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
    /// Whether it is sure: four trips say it, their mean is farther from 0 than is worth a correction,
    /// than three standard errors and than their scatter allows, and the newest confirms what those
    /// before it say. The vehicle's next trip is corrected by what is sure, but for `relative_mount`,
    /// wheels by a lidar that is not the vehicle's first, `beam_spacing` and `range_scale`. The clock
    /// never is sure: each trip measures its own.
    sure: bool,
    /// Whether the scans and odometry of its newest trip are corrected by it.
    applied: bool,
    /// The correction; null if there is none.
    #[schema(required)]
    correction: Option<CorrectionBody>,
}

/// A correction, fixed when a trip began.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Correction)]
struct CorrectionBody {
    /// The value.
    value: f64,
    /// Its standard error.
    sigma: f64,
    /// The first of the consecutive trips with this correction.
    since_trip: String,
    /// The stamp of that trip's first scan.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
}

page! {
    /// A page of a route's list of vehicles.
    #[schema(as = VehiclePage)]
    pub(super) struct VehiclePage {
        /// By name.
        items: Vec<VehicleBody>,
    }
}

/// List the vehicles of a route.
///
/// By name, all that have ever sent a batch.
#[utoipa::path(
    get, path = "/v1/routes/{route}/vehicles", tag = "vehicles",
    params(RouteParam, PageQuery),
    responses((status = 200, description = "A page of the list", body = VehiclePage), RouteProblems)
)]
pub(super) async fn list_vehicles(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<VehiclePage>, Problem> {
    let wanted = query.wanted::<VehicleId>()?;
    let vehicles = state
        .store
        .vehicle_page(&route_id, wanted.after.as_ref(), wanted.to_read());
    Ok(wanted.page(
        vehicles.await?,
        |vehicle| vehicle.id.clone(),
        VehicleBody::from,
    ))
}

/// Read a vehicle of a route.
#[utoipa::path(
    get, path = "/v1/routes/{route}/vehicles/{vehicle}", tag = "vehicles",
    params(RouteParam, VehicleParam),
    description = "Its uploads, whether it is trusted, and its calibration as estimated from its trips.",
    responses((status = 200, description = "The vehicle", body = VehicleBody), RoutePartProblems)
)]
pub(super) async fn get_vehicle(
    State(state): State<ApiState>,
    ApiPath((route_id, vehicle_id)): ApiPath<(RouteId, VehicleId)>,
) -> Result<Json<VehicleBody>, Problem> {
    known_vehicle(&state, &route_id, &vehicle_id).await
}

/// A vehicle as it is now.
///
/// # Errors
/// The [`Problem`] that there is none.
pub(super) async fn known_vehicle(
    state: &ApiState,
    route: &RouteId,
    vehicle: &VehicleId,
) -> Result<Json<VehicleBody>, Problem> {
    let known = state.store.vehicle(route, vehicle).await?;
    let known = known.ok_or_else(|| {
        let detail = format!("route {route} has no batch of a vehicle {vehicle}");
        Problem::new(ProblemKind::NotFound, detail)
    })?;
    Ok(Json(known.into()))
}

/// Why a vehicle is not trusted.
fn reasons_of(vehicle: &VehicleRecord) -> Vec<String> {
    let quarantine = vehicle.quarantine.as_ref().map(|quarantine| {
        let note = quarantine.note.as_deref().unwrap_or("no reason was given");
        format!("kept out of the map since {}: {note}", quarantine.since)
    });
    let alerts = vehicle.suspected_by.iter();
    let alerts = alerts.map(|alert| format!("alert {alert} suspects it"));
    let kept_out = vehicle.kept_out.as_ref().map(|kept_out| {
        let KeptOut { batches, reason } = kept_out;
        let newest = reason.as_deref().unwrap_or("no reason is known");
        format!(
            "{batches} of its newest batches were kept out of the map, the last because: {newest}"
        )
    });
    let reasons = quarantine.into_iter().chain(alerts).chain(kept_out);
    reasons.collect()
}

impl From<VehicleRecord> for VehicleBody {
    fn from(vehicle: VehicleRecord) -> Self {
        Self {
            id: vehicle.id.to_string(),
            route_id: vehicle.route_id.to_string(),
            state: vehicle.state(),
            reasons: reasons_of(&vehicle),
            suspected_by: vehicle.suspected_by.clone(),
            counts: VehicleCountsBody {
                trips: vehicle.trips,
                batches: vehicle.batches,
                scans: vehicle.scans,
            },
            last_seen: vehicle.last_seen,
            calibration: CalibrationBody::of(vehicle.calibrations, &vehicle.corrections, None),
            lidars: (vehicle.lidars.into_iter())
                .map(|lidar| VehicleLidarBody::of(lidar, &vehicle.corrections))
                .collect(),
        }
    }
}

impl VehicleLidarBody {
    fn of(lidar: LidarRecord, corrections: &TripCorrections) -> Self {
        let beside_primary = Some(lidar.beside_primary).filter(|trips| !trips.is_empty());
        Self {
            id: lidar.id.to_string(),
            calibration: CalibrationBody::of(lidar.calibrations, corrections, Some(&lidar.id)),
            relative_mount: beside_primary.map(RelativeMountBody::of),
        }
    }
}

fn calibrated(
    calibration: &VehicleCalibration,
    quantity: Quantity,
    applied: Option<&AppliedCorrection>,
) -> Option<CalibratedBody> {
    let combined = calibration.combined(quantity)?;
    Some(CalibratedBody {
        value: combined.estimate.value,
        sigma: combined.estimate.sigma,
        sure: calibration.sure().contains_key(&quantity)
            || calibration.uncorrected().contains_key(&quantity),
        applied: applied.is_some(),
        correction: applied.map(CorrectionBody::from),
    })
}

fn changed(calibration: &VehicleCalibration) -> Vec<String> {
    let changes = calibration.changes().into_iter();
    let standing = changes.filter(|change| change.known_anew.is_none());
    let changed = standing.map(|change| field_of(change.quantity));
    changed.map(str::to_owned).collect()
}

impl From<&AppliedCorrection> for CorrectionBody {
    fn from(applied: &AppliedCorrection) -> Self {
        Self {
            value: applied.estimate.value,
            sigma: applied.estimate.sigma,
            since_trip: applied.since_trip.to_string(),
            since: timestamp(applied.since),
        }
    }
}

impl RelativeMountBody {
    fn of(trips: Vec<CalibratedTrip>) -> Self {
        let count = trips.len();
        let combined = VehicleCalibration::of(trips);
        let calibrated = |quantity| calibrated(&combined, quantity, None);
        Self {
            trips: count,
            yaw: calibrated(Quantity::MountYaw),
            offset_x: calibrated(Quantity::MountX),
            offset_y: calibrated(Quantity::MountY),
            changed: changed(&combined),
        }
    }
}

impl CalibrationBody {
    fn of(
        trips: Vec<CalibratedTrip>,
        corrections: &TripCorrections,
        lidar: Option<&LidarId>,
    ) -> Self {
        let count = trips.len();
        let combined = VehicleCalibration::of(trips);
        let calibrated =
            |quantity| calibrated(&combined, quantity, corrections.find(lidar, quantity));
        Self {
            trips: count,
            yaw: calibrated(Quantity::MountYaw),
            offset_x: calibrated(Quantity::MountX),
            offset_y: calibrated(Quantity::MountY),
            way_scale: calibrated(Quantity::WayScale),
            turn_scale: calibrated(Quantity::TurnScale),
            turn_per_metre: calibrated(Quantity::TurnPerMetre),
            clock: calibrated(Quantity::ClockOffset),
            beam_spacing: calibrated(Quantity::BeamSpacing),
            range_scale: calibrated(Quantity::RangeScale),
            changed: changed(&combined),
            faults: combined.newest_faults().to_vec(),
        }
    }
}

/// The name of a quantity's field in [`CalibrationBody`].
pub(super) fn field_of(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::MountYaw => "yaw",
        Quantity::MountX => "offset_x",
        Quantity::MountY => "offset_y",
        Quantity::WayScale => "way_scale",
        Quantity::TurnScale => "turn_scale",
        Quantity::TurnPerMetre => "turn_per_metre",
        Quantity::ClockOffset => "clock",
        Quantity::BeamSpacing => "beam_spacing",
        Quantity::RangeScale => "range_scale",
    }
}
