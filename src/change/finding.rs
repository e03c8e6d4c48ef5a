//! What all looks at a place say together.

use super::layers::Layer;
use super::region::region_round;
use super::suspect_evidence::{SilencedChange, SuspectEvidence};
use super::{ChangeKind, Tier};
use crate::geometry::Vector2;
use crate::ids::{EdgeId, NodeId, StampNs, TripId};
use crate::scan::HeightBand;

/// The other side of one event: what left one place and stands at another, as a door does.
#[derive(Debug, Clone, PartialEq)]
pub struct Counterpart {
    /// What the other side shows.
    pub kind: ChangeKind,
    /// A simple polygon round it, map frame, metres, counter-clockwise, not closed.
    pub region: Vec<Vector2<f64>>,
}

/// A place where the world contradicts the map, as all looks known so far tell it.
///
/// Findings are a function of the set of scans and their poses, not of the order in which they
/// arrived: `since` and `until` come from the scans' stamps.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// What is contradicted.
    pub kind: ChangeKind,
    /// Its centre, map frame, metres.
    pub location: Vector2<f64>,
    /// Standard deviation of the location, metres.
    pub sigma_m: f64,
    /// A simple polygon round it, map frame, metres, counter-clockwise, not closed.
    pub region: Vec<Vector2<f64>>,
    /// How far it is to be believed.
    pub tier: Tier,
    /// The other side of the same event, if there is one.
    pub counterpart: Option<Counterpart>,
    /// The vector by which what its pass observed there would have to be moved to lie on the map,
    /// map frame, metres: of a [`ChangeKind::MapMismatch`] that one shift explains.
    pub shift: Option<Vector2<f64>>,
    /// The height bands that show it, ascending; none if it is seen by lidars that look along one
    /// plane.
    pub bands: Vec<HeightBand>,
    /// What is off and what that silences: of a [`ChangeKind::VehicleSuspect`].
    pub suspect: Option<SuspectEvidence>,
    /// The closures whose scans disagree there, ascending.
    pub edges: Vec<EdgeId>,
    /// The nodes whose scans show the old or the new state, ascending.
    pub nodes: Vec<NodeId>,
    /// The trips that saw the new state, ascending.
    pub trips: Vec<TripId>,
    /// Scans that show the new state.
    pub views: usize,
    /// Passes by the place that saw the new state.
    pub laps: usize,
    /// Probability that the finding is true, in [0, 1].
    pub confidence: f64,
    /// The first look that shows the new state.
    pub since: StampNs,
    /// The last look that shows it.
    pub last_seen: StampNs,
    /// The first look that shows the old state again; `None` while the new state stands.
    pub until: Option<StampNs>,
}

impl Finding {
    /// Whether observations of a layer show it.
    pub fn is_of(&self, layer: Layer) -> bool {
        match layer {
            Some(band) => self.bands.contains(&band),
            None => self.bands.is_empty(),
        }
    }

    /// Whether one layer shows both it and another finding: the same band, or none.
    pub(super) fn shares_a_band(&self, other: &Self) -> bool {
        let is_shared = |band| other.bands.contains(band);
        self.bands.iter().any(is_shared) || (self.bands.is_empty() && other.bands.is_empty())
    }

    /// The change, for the list of those that a vehicle's fault explains.
    pub fn as_silenced(&self) -> SilencedChange {
        SilencedChange::new(self.kind, &self.location, self.since)
    }

    /// Everything that changed with it: its region, or a convex one round both sides.
    pub fn whole_region(&self) -> Vec<Vector2<f64>> {
        match &self.counterpart {
            None => self.region.clone(),
            Some(other) => region_round(&[self.region.as_slice(), &other.region].concat(), 0.0),
        }
    }
}
