//! Vehicles that are suspected.

use super::region::region_round;
use super::suspect_evidence::SuspectEvidence;
use super::{ChangeKind, Finding, Tier};
use crate::calibration::{Displacement, VehicleFault};
use crate::geometry::Vector2;
use crate::ids::{NodeId, StampNs, TripId, VehicleId};

/// Radius of the region that stands for where the vehicle was seen first, metres.
const REGION_RADIUS_M: f64 = 0.3;

/// A vehicle whose trips say that something is off.
#[derive(Debug, Clone, PartialEq)]
pub struct Suspect {
    /// Which vehicle.
    pub vehicle: VehicleId,
    /// What is off.
    pub faults: Vec<VehicleFault>,
    /// The trips that say so, ascending.
    pub trips: Vec<TripId>,
    /// Scans that they rest on.
    pub scans: usize,
    /// What the vehicle saw up to then was seen before; `None` if it was always so.
    pub sound_until: Option<StampNs>,
    /// Of the first trip that says so.
    pub since: StampNs,
    /// Of the last.
    pub last_seen: StampNs,
    /// From when on the vehicle is known anew; `None` while it is not.
    pub until: Option<StampNs>,
    /// Confirmed if two trips say so.
    pub tier: Tier,
    /// How many standard errors the plainest fault is away from none.
    pub significance: f64,
}

impl Suspect {
    /// How far its faults may put what the vehicle sees beside where it is.
    pub fn displacement(&self) -> Displacement {
        let faults = self.faults.iter().map(VehicleFault::displacement);
        faults.fold(Displacement::default(), Displacement::and)
    }

    /// The finding against the vehicle, seen first from a node at a place.
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
