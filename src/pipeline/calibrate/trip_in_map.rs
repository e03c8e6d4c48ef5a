//! A trip whose vehicle is calibrated.

use std::collections::BTreeMap;

use crate::calibration::TripCorrections;
use crate::ids::{TripId, VehicleId};
use crate::mapping::RouteMap;

/// A trip to calibrate from, and the map that its scans are in.
pub(in crate::pipeline) struct TripInMap<'a> {
    pub map: &'a RouteMap,
    /// The vehicle of every trip in the map.
    pub vehicles: &'a BTreeMap<TripId, VehicleId>,
    pub trip: &'a TripId,
    /// The trip's vehicle.
    pub vehicle: &'a VehicleId,
    /// What was corrected when the trip entered the map.
    pub corrections: &'a TripCorrections,
}
