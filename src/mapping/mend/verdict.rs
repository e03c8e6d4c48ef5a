//! What the keyframes of a segment say together.

use super::segment::{Said, Segment, Vote};
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;

    fn vote(at_m: f64, moved: [f64; 2], turned_rad: f64) -> Said {
        Said::Elsewhere(Vote {
            place: 0,
            pose: Pose2::new(at_m, 0.0, 0.0),
            moved: moved.into(),
            turned_rad,
            closures: Vec::new(),
        })
    }

    fn judged(said: Vec<Said>, shift: Option<[f64; 2]>) -> Option<(usize, Vector2<f64>)> {
        let segment = Segment::of_places(vec![0], shift.map(Vector2::from), 6.0);
        agreed(said, &segment).map(|verdict| (verdict.votes.len(), verdict.shift))
    }

    fn three() -> Vec<Said> {
        let votes = [(0.0, [0.4, 0.0]), (1.5, [0.42, 0.01]), (3.0, [0.4, -0.01])];
        votes.map(|(at_m, moved)| vote(at_m, moved, 0.0)).into()
    }

    #[test]
    fn three_that_agree_and_lie_apart_are_enough() {
        assert_eq!(judged(three(), None).map(|(votes, _)| votes), Some(3));
        assert!(judged(three(), Some([0.35, 0.0])).is_some());
        let mut two = three();
        two.pop();
        assert!(judged(two, None).is_none());
        assert!(judged(Vec::new(), None).is_none());
    }

    #[test]
    fn one_place_another_shift_or_contradiction_proves_nothing() {
        let at_one_place = (0..9).map(|k| vote(0.1 * f64::from(k), [0.4, 0.0], 0.0));
        assert!(judged(at_one_place.collect(), None).is_none());
        assert!(judged(three(), Some([0.1, 0.0])).is_none());
        let mut right = three();
        right.extend([Said::Here, Said::Here]);
        assert!(judged(right, None).is_none());
        let mut silent = three();
        silent.extend([Said::Nothing, Said::Nothing, Said::Here]);
        assert!(judged(silent, None).is_some());
        let turned = [0.0, 0.1, 0.2].map(|rad| vote(10.0 * rad, [0.4, 0.0], rad));
        assert!(judged(turned.into(), None).is_none());
    }
}
