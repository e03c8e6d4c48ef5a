//! What the keyframes of a segment say together.

use super::vote::{Said, Segment, Vote};
use crate::geometry::Vector2;

/// Fewest keyframes that must agree …
const AGREEING_MIN: usize = 3;
/// … and the least share of those that say anything.
const AGREEING_SHARE_MIN: f64 = 0.75;
/// They lie over at least this much of the map, metres, …
const SPREAD_MIN_M: f64 = 1.0;
/// … and over this share of the segment.
const SPREAD_SHARE_MIN: f64 = 1.0 / 3.0;
/// A keyframe agrees if it would be moved by no more or less than this, metres, …
const SAME_SHIFT_M: f64 = 0.1;
/// … and turned, radians.
const SAME_TURN_RAD: f64 = 0.03;
/// As near to it is the shift that was expected, metres.
const EXPECTED_WITHIN_M: f64 = 0.15;

/// A segment with where it belongs.
pub(super) struct Verdict {
    /// By which it is to be moved, map frame, metres …
    pub shift: Vector2<f64>,
    /// … and turned, radians.
    turn_rad: f64,
    /// What proves it.
    pub votes: Vec<Vote>,
    /// The keyframes that are to move, in the order of the drive.
    pub places: Vec<usize>,
}

impl Verdict {
    /// Whether a keyframe would be moved alike.
    pub(super) fn is_agreed_by(&self, vote: &Vote) -> bool {
        (vote.moved - self.shift).norm() <= SAME_SHIFT_M
            && (vote.turned_rad - self.turn_rad).abs() <= SAME_TURN_RAD
    }
}

/// Where a segment belongs, if enough of its keyframes, spread over it, agree on that and few say
/// otherwise.
pub(super) fn agreed(said: Vec<Said>, segment: &Segment) -> Option<Verdict> {
    let (mut votes, mut otherwise) = (Vec::new(), 0);
    for said in said {
        match said {
            Said::Elsewhere(vote) => votes.push(vote),
            Said::Here => otherwise += 1,
            Said::Nothing => {}
        }
    }
    let all = votes.len() + otherwise;
    let of = |value: fn(&Vote) -> f64| median(votes.iter().map(value).collect());
    let verdict = Verdict {
        shift: Vector2::new(of(|vote| vote.moved.x)?, of(|vote| vote.moved.y)?),
        turn_rad: of(|vote| vote.turned_rad)?,
        votes: Vec::new(),
        places: segment.places.clone(),
    };
    votes.retain(|vote| verdict.is_agreed_by(vote));
    let is_expected = segment
        .shift
        .is_none_or(|shift| (shift - verdict.shift).norm() <= EXPECTED_WITHIN_M);
    let is_proven = votes.len() >= AGREEING_MIN
        && votes.len() as f64 >= AGREEING_SHARE_MIN * all as f64
        && spread_m(votes.iter().map(|vote| vote.pose.translation()))
            >= SPREAD_MIN_M.max(SPREAD_SHARE_MIN * segment.extent_m);
    (is_expected && is_proven).then_some(Verdict { votes, ..verdict })
}

/// The middle one; of two the lower.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len().checked_sub(1)? / 2).copied()
}

/// How far some places lie apart at most, metres.
pub(super) fn spread_m(places: impl Iterator<Item = Vector2<f64>> + Clone) -> f64 {
    let apart = places
        .clone()
        .flat_map(|a| places.clone().map(move |b| (a - b).norm()));
    apart.fold(0.0, f64::max)
}
