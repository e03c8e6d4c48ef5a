//! An alert as it is scored, whichever detector raised it.

use crate::change::{ChangeKind, Counterpart, Tier};
use crate::geometry::{Vector2, distance_to_polygon, polygon_gap};
use crate::ids::StampNs;

/// An open alert.
#[derive(Debug, Clone, PartialEq)]
pub struct ScoredAlert {
    /// What it reports.
    pub kind: ChangeKind,
    /// Its centre, map frame, metres.
    pub location: Vector2<f64>,
    /// A simple polygon round it, map frame, metres, not closed.
    pub region: Vec<Vector2<f64>>,
    /// The other side of the same event.
    pub counterpart: Option<Counterpart>,
    /// How far it is to be believed; `None` of detectors that do not say.
    pub tier: Option<Tier>,
    /// Passes that had shown the new state when it was first open.
    pub passes_when_raised: Option<usize>,
    /// The batch, counted from 0 over the whole run, after which it was first open.
    pub batch_when_raised: Option<usize>,
    /// The first observation of the new state.
    pub since: StampNs,
}

impl ScoredAlert {
    /// Its two sides, the counterpart last.
    pub(super) fn sides(&self) -> impl Iterator<Item = (ChangeKind, &[Vector2<f64>])> {
        let counterpart = self.counterpart.as_ref();
        std::iter::once((self.kind, self.region.as_slice()))
            .chain(counterpart.map(|other| (other.kind, other.region.as_slice())))
    }

    /// Whether a side of a kind lies within a distance of a point, metres.
    pub(super) fn reports(&self, kind: ChangeKind, point: &Vector2<f64>, within_m: f64) -> bool {
        self.sides().any(|(of_kind, region)| {
            of_kind == kind && distance_to_polygon(point, region) <= within_m
        })
    }

    /// Whether another alert of the same kind lies within a distance, metres.
    pub(super) fn repeats(&self, other: &Self, within_m: f64) -> bool {
        self.kind == other.kind && polygon_gap(&self.region, &other.region) <= within_m
    }
}
