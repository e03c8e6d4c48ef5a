//! A place where the world contradicts the map.

use super::layers::Layer;
use super::region::region_round;
use super::suspect_evidence::{SilencedChange, SuspectEvidence};
use super::{ChangeKind, Tier};
use crate::geometry::Vector2;
use crate::ids::{EdgeId, NodeId, StampNs, TripId};
use crate::scan::HeightBand;

/// The other side of one event: an object, such as a door, left one place and is at another.
#[derive(Debug, Clone, PartialEq)]
pub struct Counterpart {
    /// The kind of the other side.
    pub kind: ChangeKind,
    /// A simple polygon round it, map frame, metres, counter-clockwise, not closed.
    pub region: Vec<Vector2<f64>>,
}

/// A place where the world contradicts the map, by all observations so far.
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
    /// How certain it is.
    pub tier: Tier,
    /// The other side of the same event, if there is one.
    pub counterpart: Option<Counterpart>,
    /// Of a [`ChangeKind::MapMismatch`] that one shift explains: the vector by which its pass's observations
    /// would have to be moved to fit the map, map frame, metres.
    pub shift: Option<Vector2<f64>>,
    /// The height bands that show it, ascending; none if planar lidars do.
    pub bands: Vec<HeightBand>,
    /// Of a [`ChangeKind::VehicleSuspect`]: its faults, and the changes that they silence.
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
    /// The first observation of the new state.
    pub since: StampNs,
    /// The last observation of it.
    pub last_seen: StampNs,
    /// The first observation of the old state again; `None` while the new state lasts.
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

    /// The entry for it in the list of changes that a vehicle's fault explains.
    pub fn as_silenced(&self) -> SilencedChange {
        SilencedChange::new(self.kind, &self.location, self.since)
    }

    /// Its region; with a counterpart the convex hull of both sides.
    pub fn whole_region(&self) -> Vec<Vector2<f64>> {
        match &self.counterpart {
            None => self.region.clone(),
            Some(other) => region_round(&[self.region.as_slice(), &other.region].concat(), 0.0),
        }
    }
}
