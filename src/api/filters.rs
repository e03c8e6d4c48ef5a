//! Conditions of several lists, checked.

use jiff::Timestamp;

use super::problem::Problem;
use crate::ids::{RouteId, VehicleId};

/// The `route_id` parameter.
///
/// # Errors
/// 400 for a text that is not a name.
pub(super) fn checked_route(name: Option<&str>) -> Result<Option<RouteId>, Problem> {
    let route = name.map(RouteId::new).transpose();
    route.map_err(|error| Problem::parameter("route_id", error.to_string()))
}

/// The `vehicle_id` parameter.
///
/// # Errors
/// 400 for a text that is not a name.
pub(super) fn checked_vehicle(name: Option<&str>) -> Result<Option<VehicleId>, Problem> {
    let vehicle = name.map(VehicleId::new).transpose();
    vehicle.map_err(|error| Problem::parameter("vehicle_id", error.to_string()))
}

/// A parameter that is a time.
///
/// # Errors
/// 400 for a text that is not a time.
pub(super) fn checked_time(
    parameter: &'static str,
    text: Option<&str>,
) -> Result<Option<Timestamp>, Problem> {
    let refuse = |_| {
        let detail = format!(
            "{parameter} is a time as in 2026-11-20T06:00:00Z (RFC 3339; a + is sent as %2B)"
        );
        Problem::parameter(parameter, detail)
    };
    text.map(str::parse).transpose().map_err(refuse)
}
