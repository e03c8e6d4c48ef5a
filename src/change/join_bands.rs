//! One event, one finding, however many height bands show it.

use super::Finding;
use super::join::is_one_event;
use super::region::{centroid, region_round};
use crate::geometry::polygon_gap;

/// What two bands show of one thing lies no farther apart than this, metres: the legs of a table
/// and its top.
const APART_MAX_M: f64 = 0.3;

/// Joins findings of one kind that different bands show at one place, begun in one pass: they are
/// one event. The region is a convex one round all of them. What one band alone shows stays as it is.
pub fn join_bands(findings: Vec<Finding>) -> Vec<Finding> {
    let mut event_of: Vec<usize> = (0..findings.len()).collect();
    for (k, a) in findings.iter().enumerate() {
        for (n, b) in findings.iter().enumerate().skip(k + 1) {
            if is_of_one_thing(a, b) {
                let (first, other) = (event_of[k].min(event_of[n]), event_of[k].max(event_of[n]));
                let ends = event_of.iter_mut().filter(|event| **event == other);
                ends.for_each(|event| *event = first);
            }
        }
    }
    let events = (0..findings.len()).filter(|&k| event_of[k] == k);
    let joined = events.map(|event| {
        let parts = (0..findings.len()).filter(|&k| event_of[k] == event);
        let parts: Vec<&Finding> = parts.map(|k| &findings[k]).collect();
        match parts.as_slice() {
            [one] => (*one).clone(),
            parts => joined(parts),
        }
    });
    joined.collect()
}

/// Takes findings of several bands apart: one for each band, with the evidence of all, so that each
/// can be judged with the others of its band. Joined again they are what they were.
pub fn separate_bands(findings: Vec<Finding>) -> Vec<Finding> {
    let apart = findings.into_iter().flat_map(|finding| {
        let bands = match finding.bands.len() {
            0 | 1 => vec![finding.bands.clone()],
            _ => finding.bands.iter().map(|band| vec![*band]).collect(),
        };
        let of_band = move |bands| Finding {
            bands,
            ..finding.clone()
        };
        bands.into_iter().map(of_band)
    });
    apart.collect()
}

fn is_of_one_thing(a: &Finding, b: &Finding) -> bool {
    a.kind == b.kind
        && !a.shares_a_band(b)
        && is_one_event(a, b)
        && polygon_gap(&a.region, &b.region) <= APART_MAX_M
}

fn joined(parts: &[&Finding]) -> Finding {
    let corners = parts.iter().flat_map(|part| &part.region);
    let region = region_round(&corners.copied().collect::<Vec<_>>(), 0.0);
    let first = parts[0];
    let since = parts.iter().map(|part| part.since).min();
    let last_seen = parts.iter().map(|part| part.last_seen).max();
    Finding {
        location: centroid(&region),
        region,
        sigma_m: parts.iter().map(|part| part.sigma_m).fold(0.0, f64::max),
        tier: parts
            .iter()
            .fold(first.tier, |tier, part| tier.max(part.tier)),
        bands: union(parts, |part| &part.bands),
        edges: union(parts, |part| &part.edges),
        nodes: union(parts, |part| &part.nodes),
        trips: union(parts, |part| &part.trips),
        // No scan counts twice.
        views: parts.iter().map(|part| part.views).max().unwrap_or(0),
        laps: parts.iter().map(|part| part.laps).max().unwrap_or(0),
        confidence: parts.iter().map(|part| part.confidence).fold(0.0, f64::max),
        since: since.unwrap_or(first.since),
        last_seen: last_seen.unwrap_or(first.last_seen),
        until: parts.iter().filter_map(|part| part.until).max(),
        ..first.clone()
    }
}

/// What any of the findings has, ascending.
fn union<T: Ord + Clone>(parts: &[&Finding], of: impl Fn(&Finding) -> &Vec<T>) -> Vec<T> {
    let mut all: Vec<T> = parts.iter().flat_map(|part| of(part)).cloned().collect();
    all.sort_unstable();
    all.dedup();
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::{ChangeKind, join_counterparts, separate_counterparts, testing};
    use crate::ids::{StampNs, TripId};
    use crate::scan::HeightBand;

    use ChangeKind::{Appeared, Disappeared};

    fn low() -> HeightBand {
        HeightBand::new(0.1, 0.4).unwrap()
    }

    fn high() -> HeightBand {
        HeightBand::new(0.6, 1.0).unwrap()
    }

    /// At a place along x, of half a width.
    fn of(band: HeightBand, kind: ChangeKind, x: f64, half_m: f64) -> Finding {
        Finding {
            bands: vec![band],
            ..testing::finding(kind, [x, 0.0], half_m, 10)
        }
    }

    #[test]
    fn the_legs_and_the_top_of_a_table_are_one_event() {
        let joined = join_bands(vec![
            of(low(), Appeared, 0.0, 0.03),
            of(low(), Appeared, 1.0, 0.03),
            of(high(), Appeared, 0.5, 0.4),
            of(low(), Appeared, 5.0, 0.2),
        ]);
        assert_eq!(joined.len(), 2);
        assert_eq!(joined[0].bands, [low(), high()]);
        assert!((joined[0].location.x - 0.5).abs() < 1e-9);
        let width = joined[0].region.iter().map(|c| c.x).fold(0.0, f64::max);
        assert!((width - 1.03).abs() < 1e-9);
        assert_eq!(joined[1], of(low(), Appeared, 5.0, 0.2));
    }

    #[test]
    fn what_is_joined_and_taken_apart_is_joined_to_the_same() {
        let moved = vec![
            of(low(), Appeared, 0.0, 0.2),
            of(high(), Appeared, 0.1, 0.3),
            of(low(), Disappeared, 1.0, 0.2),
            of(high(), Disappeared, 1.1, 0.3),
        ];
        let joined = join_counterparts(join_bands(moved));
        assert_eq!(joined.len(), 1);
        assert_eq!(joined[0].bands, [low(), high()]);
        let apart = separate_bands(separate_counterparts(joined.clone()));
        assert_eq!(apart.len(), 4);
        assert_eq!(join_counterparts(join_bands(apart)), joined);
    }

    #[test]
    fn one_band_another_kind_or_another_pass_is_another_event() {
        let first = of(low(), Appeared, 0.0, 0.2);
        for other in [
            of(low(), Appeared, 0.1, 0.2),
            of(high(), Disappeared, 0.1, 0.2),
            of(high(), Appeared, 0.8, 0.2),
            Finding {
                since: StampNs(400_000_000_000),
                ..of(high(), Appeared, 0.1, 0.2)
            },
            Finding {
                trips: vec![TripId::new("tuesday").unwrap()],
                ..of(high(), Appeared, 0.1, 0.2)
            },
            Finding {
                until: Some(StampNs(900_000_000_000)),
                ..of(high(), Appeared, 0.1, 0.2)
            },
        ] {
            let apart = vec![first.clone(), other];
            assert_eq!(join_bands(apart.clone()), apart);
        }
    }

    #[test]
    fn what_one_band_lost_and_another_gained_was_not_moved() {
        let apart = vec![
            of(low(), Appeared, 0.0, 0.2),
            of(high(), Disappeared, 0.6, 0.2),
        ];
        assert_eq!(join_counterparts(apart.clone()), apart);
    }
}
