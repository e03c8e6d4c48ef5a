//! A route's map made from recorded laps.

use std::collections::BTreeMap;

use anyhow::Context;

use super::case::Acceptance;
use super::laps::{Laps, RecordedScan};
use crate::change::paper::ClosurePlace;
use crate::change::{FALSE_ALERTS_PER_LAP, Finding};
use crate::geometry::{Vector2, angle_difference_rad};
use crate::ids::{StampNs, TripId};
use crate::mapping::{Closure, Drive, InitialPose, RouteMap, Scope, Sites, Weighting};

/// A node farther than this from the truth, metres, makes a map incorrect …
const SHIFT_MAX_M: f64 = 1.0;
/// … and so does one turned by more than this, radians.
const TURN_MAX_RAD: f64 = 0.1;
/// Fewer closures a lap after the change than this share of those before are a significant drop.
const CLOSURES_KEPT_MIN: f64 = 0.5;

/// Why a case is left out of the scoring, as the paper leaves cases out (section 5.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Exclusion {
    /// The map is far from the truth.
    IncorrectMap,
    /// Closures became much fewer after the change.
    DroppedClosures,
    /// More area appeared than all original objects have.
    TooMuchChange,
}

impl Exclusion {
    /// In tables.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::IncorrectMap => "incorrect map",
            Self::DroppedClosures => "dropped closures",
            Self::TooMuchChange => "too much change",
        }
    }
}

/// A closure with its scans.
#[derive(Debug, Clone)]
pub(super) struct MadeClosure {
    /// As the map has it.
    pub closure: Closure,
    /// The old node's scan, by its place in [`Laps::scans`].
    pub old: usize,
    /// The new node's scan.
    pub new: usize,
    /// When and where.
    pub place: ClosurePlace,
}

/// A map with its closures in the order of insertion.
pub(super) struct Mapped {
    /// The map after the last lap.
    pub map: RouteMap,
    /// All closures.
    pub closures: Vec<MadeClosure>,
    /// The service's findings after each lap; only of robust maps.
    pub findings: Vec<Vec<Finding>>,
    /// Its errors.
    pub error: MapError,
    /// Why it is not scored.
    pub exclusion: Option<Exclusion>,
}

/// The largest errors of a map's nodes.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub(super) struct MapError {
    /// From the true place, metres.
    pub shift_m: f64,
    /// From the true course, radians.
    pub turn_rad: f64,
}

impl Mapped {
    /// Maps the laps, one upload a lap.
    ///
    /// # Errors
    /// If the map refuses a lap.
    pub(super) fn of(
        laps: &Laps,
        weighting: Weighting,
        acceptance: Acceptance,
    ) -> anyhow::Result<Self> {
        let mut map = RouteMap::new(weighting).with_closure_rule(acceptance.rule());
        let trip = TripId::new("laps")?;
        let scan_of: BTreeMap<StampNs, usize> = (laps.scans.iter().enumerate())
            .map(|(k, scan)| (scan.scan.stamp, k))
            .collect();
        let (mut made, mut findings) = (Vec::new(), Vec::new());
        for lap in laps.scans.chunk_by(|a, b| a.lap == b.lap) {
            let added = map.extend(&Drive {
                wheels: Default::default(),
                trip: trip.clone(),
                initial_pose: lap.first().map(start),
                scans: lap.iter().map(|s| s.scan.clone()).collect(),
            })?;
            for closure in added.closures {
                let both = ends(&map, &closure, &scan_of);
                let (old, new) = both.context("a closure without its scans")?;
                made.push((closure, old, new));
            }
            if weighting == Weighting::Robust {
                let found = map.findings(&Scope {
                    sites: Sites::All,
                    pending: &[],
                    false_alerts_per_lap: FALSE_ALERTS_PER_LAP,
                    accepted: &[],
                    vehicles: &BTreeMap::new(),
                    suspects: &[],
                });
                findings.push(found);
            }
        }
        let closures = made.into_iter().map(|(closure, old, new)| {
            Some(MadeClosure {
                place: ClosurePlace {
                    position: halfway(&map, &closure)?,
                    lap: laps.scans[new].lap,
                },
                closure,
                old,
                new,
            })
        });
        let closures: Option<Vec<MadeClosure>> = closures.collect();
        let closures = closures.context("a closure without its nodes")?;
        let error = error_of(laps, &map, &scan_of).context("a node without its scan")?;
        let exclusion = exclusion(laps, &error, &closures);
        Ok(Self {
            map,
            closures,
            findings,
            error,
            exclusion,
        })
    }

    /// When and where the closures were made.
    pub(super) fn places(&self) -> Vec<ClosurePlace> {
        self.closures.iter().map(|c| c.place).collect()
    }
}

/// The start of the first lap is known; a continued trip needs none.
fn start(scan: &RecordedScan) -> InitialPose {
    InitialPose {
        pose: scan.truth,
        sigma_xy_m: 0.01,
        sigma_theta_rad: 0.002,
    }
}

/// The position of a closure in the final map: no method knows the truth.
fn halfway(map: &RouteMap, closure: &Closure) -> Option<Vector2<f64>> {
    let graph = map.graph();
    let edge = graph.edge(closure.edge)?;
    let at = |node| Some(graph.nodes()[graph.node_position(node)?].pose.translation());
    Some(0.5 * (at(edge.from)? + at(edge.to)?))
}

fn ends(
    map: &RouteMap,
    closure: &Closure,
    scan_of: &BTreeMap<StampNs, usize>,
) -> Option<(usize, usize)> {
    let graph = map.graph();
    let edge = graph.edge(closure.edge)?;
    let scan = |node| {
        let keyframe = &map.keyframes()[graph.node_position(node)?];
        scan_of.get(&keyframe.stamp).copied()
    };
    Some((scan(edge.from)?, scan(edge.to)?))
}

fn error_of(laps: &Laps, map: &RouteMap, scan_of: &BTreeMap<StampNs, usize>) -> Option<MapError> {
    let mut error = MapError::default();
    for (node, keyframe) in map.graph().nodes().iter().zip(map.keyframes()) {
        let truth = &laps.scans[*scan_of.get(&keyframe.stamp)?].truth;
        let shift_m = (truth.translation() - node.pose.translation()).norm();
        error.shift_m = error.shift_m.max(shift_m);
        let turn_rad = angle_difference_rad(truth.theta, node.pose.theta);
        error.turn_rad = error.turn_rad.max(turn_rad);
    }
    Some(error)
}

fn exclusion(laps: &Laps, error: &MapError, closures: &[MadeClosure]) -> Option<Exclusion> {
    if laps.appeared_area_share > 1.0 {
        return Some(Exclusion::TooMuchChange);
    }
    if error.shift_m > SHIFT_MAX_M || error.turn_rad > TURN_MAX_RAD {
        return Some(Exclusion::IncorrectMap);
    }
    // The first lap has next to no closures.
    let in_laps = |from: usize, until: usize| {
        let there = closures
            .iter()
            .filter(|c| (from..until).contains(&c.place.lap));
        there.count() as f64 / (until - from).max(1) as f64
    };
    let (before, after) = (in_laps(1, laps.before), in_laps(laps.before, laps.count));
    (after < CLOSURES_KEPT_MIN * before).then_some(Exclusion::DroppedClosures)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::super::case::{Case, Seeds};
    use super::super::protocol;
    use super::*;

    #[test]
    fn closures_know_their_scans_and_cases_their_reasons() {
        let case = protocol::cases(true, Seeds::Tuning).remove(1);
        let mut laps = Laps::drive(&case).unwrap();
        let paper = |laps: &Laps, acceptance| {
            Mapped::of(laps, Weighting::AllPointsIdentity, acceptance).unwrap()
        };
        let mapped = paper(&laps, Acceptance::Medium);
        assert_eq!(mapped.exclusion, None);
        assert!(mapped.closures.len() > 100 && mapped.findings.is_empty());
        for made in &mapped.closures {
            assert!(made.old < made.new && laps.scans[made.new].lap == made.place.lap);
            let way = laps.scans[made.old]
                .truth
                .between(&laps.scans[made.new].truth);
            assert!(
                way.translation().norm() < 2.0,
                "the paper's loop-closure candidates are near"
            );
        }
        let strict = paper(&laps, Acceptance::High);
        assert!(strict.closures.len() <= mapped.closures.len());
        laps.appeared_area_share = 1.1;
        let too_much = paper(&laps, Acceptance::Medium).exclusion;
        assert_eq!(too_much, Some(Exclusion::TooMuchChange));
    }

    #[test]
    fn the_faithful_map_keeps_closures_that_the_gates_refuse() {
        let case = Case {
            changes: 50,
            ..protocol::cases(true, Seeds::Tuning).remove(1)
        };
        let laps = Laps::drive(&case).unwrap();
        // The scans after the change that are tied to the world before it.
        let tied = |weighting| {
            let mapped = Mapped::of(&laps, weighting, Acceptance::Medium).unwrap();
            let across = mapped.closures.into_iter();
            let across = across.filter(|made| laps.crosses_change(made.old, made.new));
            across.map(|made| made.new).collect::<BTreeSet<usize>>()
        };
        let (gated, faithful) = (tied(Weighting::AllPointsIdentity), tied(Weighting::Paper));
        let kept = faithful.difference(&gated).count();
        // The score refuses others: it is a gate too.
        let refused = gated.difference(&faithful).count();
        assert!(
            kept >= 3,
            "{kept} of {} kept, {refused} refused",
            faithful.len()
        );
    }
}
