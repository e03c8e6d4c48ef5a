//! Findings that one shift of the map explains: a map error, not changes of the world.
//!
//! If the poses of a trip are off by some decimetres along a segment, every object there seems to have moved
//! by the same vector. One such pair looks like an object that was moved; together they are one
//! `map_mismatch`.

use std::collections::BTreeSet;

use super::median::median;
use super::region::{centroid, region_round};
use super::shift_fit::{SHIFT_MAX_M, SHIFT_MIN_M};
use super::{ChangeKind, Finding, ShiftFit, Tier};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::ids::StampNs;

/// Findings of one pass begin no farther apart, nanoseconds.
const APART_MAX_NS: i64 = 120_000_000_000;
/// Largest difference of the two outlines, moved onto each other, metres. A door leaf differs by more, since
/// it turns.
const OUTLINE_DIFFERENCE_MAX_M: f64 = 0.25;
/// Largest difference of a pair's shift from the common one, metres: partly observed objects are located no
/// better.
const SAME_SHIFT_M: f64 = 0.12;
/// Pairs of one segment are no farther than this from the next one, metres.
const LINK_M: f64 = 8.0;
/// Fewest pairs: two objects that moved by the same vector are not rare.
const PAIRS_MIN: usize = 3;
/// Least extent of the pairs, metres: the legs of one table or shelf that was moved are closer together.
const EXTENT_MIN_M: f64 = 2.5;
/// Findings of the pass this near to an explained one should be explained too, metres: …
const NEAR_M: f64 = 4.0;
/// … for each that is not, at least this many are.
const EXPLAINED_PER_LEFT_MIN: usize = 2;

/// An object that seems to have moved, as one trip observed it.
struct Pair {
    appeared: usize,
    disappeared: usize,
    /// Half-way between the two, map frame, metres.
    place: Vector2<f64>,
    /// The vector from what appeared to what disappeared, metres.
    shift: Vector2<f64>,
}

impl Pair {
    fn findings(&self) -> [usize; 2] {
        [self.appeared, self.disappeared]
    }
}

/// Pairs of a segment with their common shift.
struct Segment {
    /// Places in the list of pairs, ascending.
    pairs: Vec<usize>,
    /// The median of their shifts, map frame, metres.
    shift: Vector2<f64>,
}

/// Replaces findings that one shift explains by one `map_mismatch`. Every other finding stays as and where it
/// is; mismatches follow.
///
/// Only findings of state are considered that a single pass shows (`is_of_one_pass`) and that have no
/// counterpart: a second pass or trip that shows the same is evidence of a change. What appeared is paired
/// with what disappeared within 1.5 m, if both began in one pass and their outlines are alike. At least three
/// pairs of different findings, over at least 2.5 m of the map, with one displacement to within
/// 0.12 m and of at least 0.1 m, are a map error, unless more than a third of the pass's findings
/// around them are left unexplained. Fewer may be a door, a chair, or things that were pushed.
///
/// The mismatch is tentative. Its [`shift`](Finding::shift) is the vector by which what the pass
/// observed there would have to be moved to lie on the map (map frame, metres): the displacement
/// from what disappeared to what appeared, reversed. That is rough, since of things that are wider
/// than the shift only the ends appear and disappear: `measured` is given the mismatch with it, and
/// returns the shift at which the observations fit, or `None` if none does; then nothing is explained. Other
/// findings of the pass within 4 m that this shift explains join the mismatch. It ends when all of them have
/// ended.
pub fn explain_by_shift(
    findings: Vec<Finding>,
    is_of_one_pass: impl Fn(&Finding) -> bool,
    measured: impl Fn(&Finding) -> Option<ShiftFit>,
) -> Vec<Finding> {
    let mut order: Vec<usize> = (0..findings.len())
        .filter(|&k| is_considered(&findings[k]) && is_of_one_pass(&findings[k]))
        .collect();
    order.sort_by(|&a, &b| in_order(&findings[a], &findings[b]));
    let considered: Vec<&Finding> = order.iter().map(|&k| &findings[k]).collect();
    let mut pairs = pairs_of(&considered);
    let mut explained = BTreeSet::new();
    let mut mismatches = Vec::new();
    while let Some(segment) = best_segment(&considered, &explained, &pairs) {
        let mut found: BTreeSet<usize> = findings_of(&pairs, &segment.pairs).collect();
        let parts = |found: &BTreeSet<usize>| -> Vec<&Finding> {
            found.iter().map(|&k| considered[k]).collect()
        };
        let rough = mismatch_of(&parts(&found), segment.shift);
        if let Some(fit) = measured(&rough) {
            let near = left_near(&considered, &explained, &found);
            let also: Vec<usize> = near.filter(|&k| fit.explains(considered[k])).collect();
            found.extend(also);
            mismatches.push(mismatch_of(&parts(&found), fit.shift()));
            explained.extend(&found);
        }
        pairs.retain(|pair| pair.findings().iter().all(|k| !found.contains(k)));
    }
    let replaced: BTreeSet<usize> = explained.into_iter().map(|k| order[k]).collect();
    let left = findings.into_iter().enumerate();
    let left = left.filter(|(k, _)| !replaced.contains(k));
    left.map(|(_, finding)| finding).chain(mismatches).collect()
}

fn is_considered(finding: &Finding) -> bool {
    finding.kind.is_of_state() && finding.trips.len() == 1 && finding.counterpart.is_none()
}

/// An order that depends on the findings alone.
fn in_order(a: &Finding, b: &Finding) -> std::cmp::Ordering {
    (&a.trips, a.since, a.kind, a.last_seen)
        .cmp(&(&b.trips, b.since, b.kind, b.last_seen))
        .then(a.location.x.total_cmp(&b.location.x))
        .then(a.location.y.total_cmp(&b.location.y))
}

fn is_one_pass(a: &Finding, b: &Finding) -> bool {
    a.trips == b.trips && a.since.0.abs_diff(b.since.0) <= APART_MAX_NS.unsigned_abs()
}

/// All pairs of a disappeared and an appeared finding that may be one moved object.
fn pairs_of(findings: &[&Finding]) -> Vec<Pair> {
    let of_kind = |kind| (0..findings.len()).filter(move |&k| findings[k].kind == kind);
    let mut pairs = Vec::new();
    for appeared in of_kind(ChangeKind::Appeared) {
        for disappeared in of_kind(ChangeKind::Disappeared) {
            let (here, there) = (findings[appeared], findings[disappeared]);
            let shift = there.location - here.location;
            if shift.norm() <= SHIFT_MAX_M
                && is_one_pass(here, there)
                && are_alike(&here.region, &there.region, &shift)
            {
                pairs.push(Pair {
                    appeared,
                    disappeared,
                    place: 0.5 * (here.location + there.location),
                    shift,
                });
            }
        }
    }
    pairs
}

/// Whether one outline, shifted, is about the other.
fn are_alike(outline: &[Vector2<f64>], other: &[Vector2<f64>], shift: &Vector2<f64>) -> bool {
    let shifted: Vec<Vector2<f64>> = outline.iter().map(|corner| corner + shift).collect();
    let lies_on = |corners: &[Vector2<f64>], polygon: &[Vector2<f64>]| {
        let mut corners = corners.iter();
        corners.all(|corner| distance_to_polygon(corner, polygon) <= OUTLINE_DIFFERENCE_MAX_M)
    };
    lies_on(&shifted, other) && lies_on(other, &shifted)
}

/// The segment with the most pairs; of those with equally many the one with the shortest shift.
fn best_segment(
    findings: &[&Finding],
    explained: &BTreeSet<usize>,
    pairs: &[Pair],
) -> Option<Segment> {
    let segments = (0..pairs.len()).filter_map(|seed| segment_of(findings, pairs, seed));
    let explaining = segments.filter(|segment| {
        segment.shift.norm() >= SHIFT_MIN_M
            && extent_m(pairs, segment) >= EXTENT_MIN_M
            && explains_surroundings(findings, explained, pairs, segment)
    });
    // The first of equal ones.
    explaining.min_by(|a, b| {
        (b.pairs.len().cmp(&a.pairs.len())).then(a.shift.norm().total_cmp(&b.shift.norm()))
    })
}

/// The pairs with the shift of a seed that are linked with it.
fn segment_of(findings: &[&Finding], pairs: &[Pair], seed: usize) -> Option<Segment> {
    let rough = linked(findings, pairs, seed, &pairs[seed].shift);
    if rough.len() < PAIRS_MIN {
        return None;
    }
    let of_segment = linked(findings, pairs, seed, &median_shift(pairs, &rough));
    (of_segment.len() >= PAIRS_MIN).then(|| Segment {
        shift: median_shift(pairs, &of_segment),
        pairs: of_segment,
    })
}

/// The pairs with about this shift that are linked with the seed, each finding in its best pair only; none if
/// the seed is not among them.
fn linked(findings: &[&Finding], pairs: &[Pair], seed: usize, shift: &Vector2<f64>) -> Vec<usize> {
    let off_m = |k: usize| (pairs[k].shift - shift).norm();
    let mut alike: Vec<usize> = (0..pairs.len())
        .filter(|&k| off_m(k) <= SAME_SHIFT_M)
        .collect();
    alike.sort_by(|&a, &b| off_m(a).total_cmp(&off_m(b)).then(a.cmp(&b)));
    let mut taken = BTreeSet::new();
    alike.retain(|&k| {
        let is_free = pairs[k].findings().iter().all(|end| !taken.contains(end));
        if is_free {
            taken.extend(pairs[k].findings());
        }
        is_free
    });
    let mut linked: Vec<usize> = Vec::new();
    linked.extend(alike.iter().find(|&&k| k == seed));
    let mut next = 0;
    while let Some(&at) = linked.get(next) {
        let (near, rest): (Vec<usize>, Vec<usize>) = alike.into_iter().partition(|&k| {
            let [a, b] = [at, k].map(|k| findings[pairs[k].appeared]);
            is_one_pass(a, b) && (pairs[k].place - pairs[at].place).norm() <= LINK_M
        });
        alike = rest;
        linked.extend(near.into_iter().filter(|&k| k != seed));
        next += 1;
    }
    linked.sort_unstable();
    linked
}

fn findings_of(pairs: &[Pair], chosen: &[usize]) -> impl Iterator<Item = usize> {
    chosen.iter().flat_map(|&k| pairs[k].findings())
}

/// The median of each coordinate, of at least one pair.
fn median_shift(pairs: &[Pair], chosen: &[usize]) -> Vector2<f64> {
    let of = |axis: usize| {
        let mut values: Vec<f64> = chosen.iter().map(|&k| pairs[k].shift[axis]).collect();
        median(&mut values)
    };
    Vector2::new(of(0), of(1))
}

/// How far its pairs lie apart at most, metres.
fn extent_m(pairs: &[Pair], segment: &Segment) -> f64 {
    let places = || segment.pairs.iter().map(|&k| pairs[k].place);
    let apart = places().flat_map(|a| places().map(move |b| (a - b).norm()));
    apart.fold(0.0, f64::max)
}

/// Whether few of the pass's findings near a segment are left that neither it nor another one
/// explains.
fn explains_surroundings(
    findings: &[&Finding],
    explained: &BTreeSet<usize>,
    pairs: &[Pair],
    segment: &Segment,
) -> bool {
    let own: BTreeSet<usize> = findings_of(pairs, &segment.pairs).collect();
    EXPLAINED_PER_LEFT_MIN * left_near(findings, explained, &own).count() <= own.len()
}

/// Those of the same pass within [`NEAR_M`] of some findings that are neither of them nor explained
/// already.
fn left_near<'a>(
    findings: &'a [&Finding],
    explained: &'a BTreeSet<usize>,
    own: &'a BTreeSet<usize>,
) -> impl Iterator<Item = usize> + 'a {
    let is_near = |k: &usize| {
        own.iter().any(|&of_own| {
            let (a, b) = (findings[of_own], findings[*k]);
            is_one_pass(a, b) && (a.location - b.location).norm() <= NEAR_M
        })
    };
    let left = (0..findings.len()).filter(|k| !own.contains(k) && !explained.contains(k));
    left.filter(is_near)
}

fn mismatch_of(parts: &[&Finding], shift: Vector2<f64>) -> Finding {
    let corners = parts.iter().flat_map(|part| &part.region);
    let region = region_round(&corners.copied().collect::<Vec<_>>(), 0.0);
    let edges: BTreeSet<_> = parts.iter().flat_map(|part| &part.edges).collect();
    let nodes: BTreeSet<_> = parts.iter().flat_map(|part| &part.nodes).collect();
    let trips: BTreeSet<_> = parts.iter().flat_map(|part| &part.trips).collect();
    let bands: BTreeSet<_> = parts.iter().flat_map(|part| &part.bands).collect();
    let since = parts.iter().map(|part| part.since);
    let last_seen = parts.iter().map(|part| part.last_seen);
    let ended: Option<Vec<_>> = parts.iter().map(|part| part.until).collect();
    Finding {
        kind: ChangeKind::MapMismatch,
        location: centroid(&region),
        sigma_m: parts.iter().map(|part| part.sigma_m).fold(0.0, f64::max),
        region,
        tier: Tier::Tentative,
        counterpart: None,
        shift: Some(shift),
        suspect: None,
        bands: bands.into_iter().copied().collect(),
        edges: edges.into_iter().copied().collect(),
        nodes: nodes.into_iter().copied().collect(),
        trips: trips.into_iter().cloned().collect(),
        // No scan counts twice.
        views: parts.iter().map(|part| part.views).max().unwrap_or(0),
        laps: parts.iter().map(|part| part.laps).max().unwrap_or(0),
        confidence: parts.iter().map(|part| part.confidence).fold(1.0, f64::min),
        since: since.min().unwrap_or(StampNs(i64::MAX)),
        last_seen: last_seen.max().unwrap_or(StampNs(0)),
        until: ended.and_then(|ended| ended.into_iter().max()),
    }
}

#[cfg(test)]
mod tests;
