//! The compared methods.

use serde::Serialize;

use super::mapped::{MadeClosure, Mapped};
use crate::change::ChangeKind;
use crate::change::paper::ClosurePlace;
use crate::geometry::Vector2;
use crate::mapping::Weighting;

/// Places of one change are this near to each other where only closures are reported, metres.
const SAME_PLACE_M: f64 = 5.0;
/// Laps that no method judges: they make the map.
pub(super) const LAPS_LEARNT: usize = 2;

/// Which measurement of a closure a baseline is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Measurement {
    /// From all points: disturbed by changes.
    AllPoints,
    /// What an optimiser is usually given.
    Robust,
}

/// How the map is made that the paper's rule reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum PaperMap {
    /// As the service's detector `seed` makes it: with the service's gates and odometry.
    Seed,
    /// As the paper says, without the service's additions.
    Faithful,
}

impl PaperMap {
    /// Both, in the order of the tables.
    pub(super) const ALL: [Self; 2] = [Self::Seed, Self::Faithful];

    /// As the map has it.
    pub(super) fn weighting(self) -> Weighting {
        match self {
            Self::Seed => Weighting::AllPointsIdentity,
            Self::Faithful => Weighting::Paper,
        }
    }

    /// In tables.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Seed => "as the service's `seed`",
            Self::Faithful => "faithful",
        }
    }
}

/// A method of change detection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Method {
    /// The paper's rule at th.
    Paper(PaperMap),
    /// The paper's rule at 2.5 th.
    PaperRaised(PaperMap),
    /// The service's detector.
    Fused,
    /// An error beyond 3 σ at the optimum, as RTAB-Map refuses closures.
    ErrorRatio(Measurement),
    /// An error beyond the 90 % point of χ²₃, as IPC tests closures.
    ChiSquared(Measurement),
    /// Switched off by graduated non-convexity.
    Gnc(Measurement),
}

impl Method {
    /// All, in the order of the tables.
    pub(super) const ALL: [Self; 11] = [
        Self::Paper(PaperMap::Seed),
        Self::Paper(PaperMap::Faithful),
        Self::PaperRaised(PaperMap::Seed),
        Self::PaperRaised(PaperMap::Faithful),
        Self::Fused,
        Self::ErrorRatio(Measurement::AllPoints),
        Self::ErrorRatio(Measurement::Robust),
        Self::ChiSquared(Measurement::AllPoints),
        Self::ChiSquared(Measurement::Robust),
        Self::Gnc(Measurement::AllPoints),
        Self::Gnc(Measurement::Robust),
    ];

    /// In tables and files.
    pub(super) fn name(self) -> &'static str {
        use Measurement::{AllPoints, Robust};
        match self {
            Self::Paper(PaperMap::Seed) => "paper as `seed`, th",
            Self::PaperRaised(PaperMap::Seed) => "paper as `seed`, 2.5 th",
            Self::Paper(PaperMap::Faithful) => "paper, faithful, th",
            Self::PaperRaised(PaperMap::Faithful) => "paper, faithful, 2.5 th",
            Self::Fused => "fused",
            Self::ErrorRatio(AllPoints) => "3σ error ratio, all points",
            Self::ErrorRatio(Robust) => "3σ error ratio, robust",
            Self::ChiSquared(AllPoints) => "χ²₃ at 90 %, all points",
            Self::ChiSquared(Robust) => "χ²₃ at 90 %, robust",
            Self::Gnc(AllPoints) => "GNC weights, all points",
            Self::Gnc(Robust) => "GNC weights, robust",
        }
    }
}

impl Serialize for Method {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// An alert of a method.
#[derive(Debug, Clone)]
pub(super) struct Raised {
    /// The lap in which it is first reported.
    pub lap: usize,
    /// What is reported.
    pub what: Reported,
}

/// What is reported.
#[derive(Debug, Clone)]
pub(super) enum Reported {
    /// "Look at this closure's two scans": scans by their places in [`Laps::scans`].
    Closure {
        /// The old node's scan.
        old: usize,
        /// The new node's scan.
        new: usize,
        /// Halfway between the nodes, map frame, metres.
        position: Vector2<f64>,
    },
    /// "Here is something new, or something gone".
    Region {
        /// Appeared or disappeared.
        kind: ChangeKind,
        /// Its middle, map frame, metres.
        location: Vector2<f64>,
        /// A polygon round it, map frame, metres.
        region: Vec<Vector2<f64>>,
    },
}

/// What a method makes of a case.
#[derive(Debug, Clone, Default)]
pub(super) struct Judged {
    /// For each closure the larger the more suspect; `None` where the method has no degrees.
    pub scores: Option<Vec<f64>>,
    /// For each closure whether the method judges it at all.
    pub judged: Vec<bool>,
    /// For each closure whether it is flagged to contradict the map.
    pub reported: Vec<bool>,
    /// What the keepers of the map get.
    pub raised: Vec<Raised>,
}

impl Judged {
    /// From closures reported one by one; in a lap those near to each other are one alert.
    pub(super) fn by_closure(
        mapped: &Mapped,
        scores: Option<Vec<f64>>,
        reported: Vec<bool>,
    ) -> Self {
        let judged: Vec<bool> = mapped.closures.iter().map(is_judged).collect();
        let reported: Vec<bool> = reported
            .iter()
            .zip(&judged)
            .map(|(t, j)| *t && *j)
            .collect();
        let raised = gather(&mapped.closures, &reported);
        Self {
            scores,
            judged,
            reported,
            raised,
        }
    }
}

fn is_judged(made: &MadeClosure) -> bool {
    made.place.lap >= LAPS_LEARNT
}

/// The first closure reported at each place in each lap: a method that sees only closures does not remember
/// earlier laps.
fn gather(closures: &[MadeClosure], reported: &[bool]) -> Vec<Raised> {
    let mut known: Vec<ClosurePlace> = Vec::new();
    let mut raised = Vec::new();
    for (made, _) in closures
        .iter()
        .zip(reported)
        .filter(|(_, reported)| **reported)
    {
        let same = |known: &ClosurePlace| {
            let apart = known.position - made.place.position;
            apart.norm() <= SAME_PLACE_M && made.place.lap == known.lap
        };
        if !known.iter().any(same) {
            known.push(made.place);
            raised.push(raised_by(made));
        }
    }
    raised
}

/// "Look at this closure".
pub(super) fn raised_by(made: &MadeClosure) -> Raised {
    Raised {
        lap: made.place.lap,
        what: Reported::Closure {
            old: made.old,
            new: made.new,
            position: made.place.position,
        },
    }
}
