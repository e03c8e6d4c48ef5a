//! Suspected vehicles.

use super::region::region_round;
use super::suspect_evidence::SuspectEvidence;
use super::{ChangeKind, Finding, Tier};
use crate::calibration::{Displacement, VehicleFault};
use crate::geometry::Vector2;
use crate::ids::{NodeId, StampNs, TripId, VehicleId};

/// Radius of the region round the vehicle's first position, metres.
const REGION_RADIUS_M: f64 = 0.3;

/// A vehicle whose calibrations show a fault.
#[derive(Debug, Clone, PartialEq)]
pub struct Suspect {
    /// Which vehicle.
    pub vehicle: VehicleId,
    /// Its faults.
    pub faults: Vec<VehicleFault>,
    /// The trips that show them, ascending.
    pub trips: Vec<TripId>,
    /// Scans of these trips.
    pub scans: usize,
    /// Up to when the vehicle was sound; `None` if it never was.
    pub sound_until: Option<StampNs>,
    /// Stamp of the first of these trips.
    pub since: StampNs,
    /// Stamp of the last.
    pub last_seen: StampNs,
    /// From when on the vehicle is calibrated again; `None` while it is not.
    pub until: Option<StampNs>,
    /// Confirmed if two trips show a fault.
    pub tier: Tier,
    /// Significance of the clearest fault, in standard errors.
    pub significance: f64,
}

impl Suspect {
    /// By how far its faults may displace what the vehicle observes.
    pub fn displacement(&self) -> Displacement {
        let faults = self.faults.iter().map(VehicleFault::displacement);
        faults.fold(Displacement::default(), Displacement::and)
    }

    /// The finding against the vehicle, located at its first node.
    pub fn finding(&self, first: NodeId, location: Vector2<f64>) -> Finding {
        Finding {
            kind: ChangeKind::VehicleSuspect,
            location,
            sigma_m: REGION_RADIUS_M,
            region: region_round(&[location], REGION_RADIUS_M),
            tier: self.tier,
            counterpart: None,
            shift: None,
            bands: Vec::new(),
            suspect: Some(SuspectEvidence {
                faults: self.faults.clone(),
                silenced: Vec::new(),
            }),
            edges: Vec::new(),
            nodes: vec![first],
            trips: self.trips.clone(),
            views: self.scans,
            laps: self.trips.len(),
            confidence: 1.0 - (-self.significance).exp(),
            since: self.since,
            last_seen: self.last_seen,
            until: self.until,
        }
    }
}
