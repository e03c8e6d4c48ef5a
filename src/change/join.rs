//! Joins the two sides of one event: what disappeared from one place and appeared at another was moved.

use super::region::centroid;
use super::{ChangeKind, Counterpart, Finding};
use crate::geometry::polygon_gap;

/// Farthest that something counts as moved, metres: a door leaf, a chair.
const MOVED_MAX_M: f64 = 1.0;
/// The two sides are first observed in one pass, at most this far apart, nanoseconds.
const APART_MAX_NS: i64 = 120_000_000_000;

/// Joins findings that are two sides of one event, the nearest first: the one that appeared stays, with the
/// other as its counterpart.
pub fn join_counterparts(findings: Vec<Finding>) -> Vec<Finding> {
    let mut pairs = Vec::new();
    for (a, appeared) in findings.iter().enumerate() {
        for (d, disappeared) in findings.iter().enumerate() {
            if appeared.kind == ChangeKind::Appeared
                && disappeared.kind == ChangeKind::Disappeared
                && appeared.shares_a_band(disappeared)
                && is_one_event(appeared, disappeared)
            {
                let gap_m = polygon_gap(&appeared.region, &disappeared.region);
                if gap_m <= MOVED_MAX_M {
                    let apart_m = (appeared.location - disappeared.location).norm();
                    pairs.push((gap_m, apart_m, a, d));
                }
            }
        }
    }
    pairs.sort_by(|a, b| {
        (a.0.total_cmp(&b.0))
            .then(a.1.total_cmp(&b.1))
            .then((a.2, a.3).cmp(&(b.2, b.3)))
    });
    let mut other_side: Vec<Option<usize>> = vec![None; findings.len()];
    for (_, _, a, d) in pairs {
        if other_side[a].is_none() && other_side[d].is_none() {
            other_side[a] = Some(d);
            other_side[d] = Some(a);
        }
    }
    let joined = findings
        .iter()
        .zip(&other_side)
        .filter_map(|(finding, other)| {
            let Some(other) = other.map(|k| &findings[k]) else {
                return Some(finding.clone());
            };
            (finding.kind == ChangeKind::Appeared).then(|| with_counterpart(finding, other))
        });
    joined.collect()
}

/// Separates joined findings, each followed by its other side, so that they can be joined again with others.
/// The other side has the evidence of both.
pub fn separate_counterparts(findings: Vec<Finding>) -> Vec<Finding> {
    let apart = findings.into_iter().flat_map(|mut finding| {
        let other = finding.counterpart.take().map(|other| Finding {
            kind: other.kind,
            location: centroid(&other.region),
            region: other.region,
            ..finding.clone()
        });
        std::iter::once(finding).chain(other)
    });
    apart.collect()
}

/// Whether both began in one pass, and both have ended or neither has.
pub(super) fn is_one_event(a: &Finding, b: &Finding) -> bool {
    let shares_a_trip = a.trips.iter().any(|trip| b.trips.contains(trip));
    shares_a_trip
        && a.since.0.abs_diff(b.since.0) <= APART_MAX_NS.unsigned_abs()
        && a.until.is_some() == b.until.is_some()
}

fn with_counterpart(appeared: &Finding, other: &Finding) -> Finding {
    let mut joined = appeared.clone();
    joined.counterpart = Some(Counterpart {
        kind: other.kind,
        region: other.region.clone(),
    });
    joined.bands.extend(&other.bands);
    joined.bands.sort_unstable();
    joined.bands.dedup();
    joined.edges.extend(&other.edges);
    joined.edges.sort_unstable();
    joined.edges.dedup();
    joined.nodes.extend(&other.nodes);
    joined.nodes.sort_unstable();
    joined.nodes.dedup();
    joined.tier = appeared.tier.max(other.tier);
    joined.confidence = appeared.confidence.max(other.confidence);
    joined.since = appeared.since.min(other.since);
    joined.last_seen = appeared.last_seen.max(other.last_seen);
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::testing;
    use crate::ids::{EdgeId, StampNs, TripId};

    /// At a place along x.
    fn finding(kind: ChangeKind, x: f64, since_s: i64) -> Finding {
        testing::finding(kind, [x, 0.0], 0.2, since_s)
    }

    use ChangeKind::{Appeared, Disappeared};

    #[test]
    fn a_door_that_swings_is_one_finding() {
        let joined = join_counterparts(vec![
            finding(Disappeared, 0.0, 20),
            finding(Appeared, 0.9, 10),
            finding(Appeared, 9.0, 10),
        ]);
        let kinds: Vec<_> = joined.iter().map(|f| (f.kind, f.location.x)).collect();
        assert_eq!(kinds, [(Appeared, 0.9), (Appeared, 9.0)]);
        let other = joined[0].counterpart.as_ref().unwrap();
        assert_eq!(other.kind, Disappeared);
        assert_eq!(joined[0].edges, [EdgeId(10), EdgeId(20)]);
        assert!(joined[1].counterpart.is_none());
    }

    #[test]
    fn what_was_taken_apart_is_joined_to_the_same() {
        let joined = join_counterparts(vec![
            finding(Disappeared, 0.0, 20),
            finding(Appeared, 0.9, 10),
            finding(Appeared, 9.0, 10),
        ]);
        let apart = separate_counterparts(joined.clone());
        let kinds: Vec<_> = apart.iter().map(|f| (f.kind, f.location.x)).collect();
        assert_eq!(
            kinds,
            [(Appeared, 0.9), (Disappeared, 0.0), (Appeared, 9.0)]
        );
        assert!(apart.iter().all(|finding| finding.counterpart.is_none()));
        assert_eq!(join_counterparts(apart), joined);
    }

    #[test]
    fn what_is_far_later_or_ended_is_another_event() {
        for other in [
            finding(Disappeared, 1.5, 10),
            finding(Disappeared, 0.5, 200),
            finding(Appeared, 0.5, 10),
            Finding {
                until: Some(StampNs(1)),
                ..finding(Disappeared, 0.5, 10)
            },
            Finding {
                trips: vec![TripId::new("tuesday").unwrap()],
                ..finding(Disappeared, 0.5, 10)
            },
        ] {
            let apart = vec![finding(Appeared, 0.0, 10), other];
            assert_eq!(join_counterparts(apart.clone()), apart);
        }
    }

    #[test]
    fn the_nearest_are_joined_and_each_but_once() {
        let joined = join_counterparts(vec![
            finding(Disappeared, 0.0, 10),
            finding(Appeared, 1.2, 10),
            finding(Appeared, -0.6, 10),
        ]);
        let with: Vec<_> = joined.iter().map(|f| f.counterpart.is_some()).collect();
        assert_eq!(with, [false, true]);
    }
}
