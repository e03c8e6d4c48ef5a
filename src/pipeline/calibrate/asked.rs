//! Who is asked.

use std::collections::BTreeMap;

use crate::calibration::TripCorrections;
use crate::ids::{TripId, VehicleId};
use crate::mapping::RouteMap;

/// A trip that is asked, and the map that it is in.
pub(in crate::pipeline) struct Asked<'a> {
    pub map: &'a RouteMap,
    /// Whose the other trips in the map are.
    pub vehicles: &'a BTreeMap<TripId, VehicleId>,
    pub trip: &'a TripId,
    /// Whose the trip is.
    pub vehicle: &'a VehicleId,
    /// What was corrected when the trip entered the map.
    pub corrections: &'a TripCorrections,
}
