//! Where single keyframes of a segment belong.

use super::super::anchor;
use super::super::closure::{self, CONTRADICTION_SHARE_MAX_FROM_AFAR, ClosureMeasurement, Slack};
use super::super::local_map::{LocalMap, evenly_chosen};
use super::super::loops::RECENT_KEYFRAMES;
use super::super::partners::{self, PARTNER_DISTANCE_MAX_M, Placed};
use super::super::route_map::RouteMap;
use super::segment::{Said, Segment, Vote};
use super::verdict::{Verdict, spread_m};
use crate::change::Finding;
use crate::geometry::{Pose2, Vector2, angle_difference_rad, wrap_angle};

/// At most so many keyframes of a segment are matched anew, evenly chosen.
const KEYFRAMES_MAX: usize = 24;
/// How far from where a known shift has a keyframe it is searched for, metres, …
const WINDOW_M: f64 = 0.35;
/// … how far where no shift is known, …
const WINDOW_UNKNOWN_M: f64 = 1.0;
/// … and how far it may be turned, radians.
const WINDOW_RAD: f64 = 0.12;
/// A match may end so far from where the search has it. It must contradict next to nothing: it
/// stands against where the map has the keyframe.
const SLACK: Slack = Slack {
    distance_m: 0.2,
    turn_rad: 0.08,
    well_known: false,
    contradiction_share_max: CONTRADICTION_SHARE_MAX_FROM_AFAR,
};
/// The match must fix even its loosest direction by this share.
const FIXED_SHARE_MIN: f64 = 0.9;
/// So much more of the scan must be explained than where the keyframe lies.
const GAIN_MIN: f64 = 0.03;
/// Matches that end no farther apart are one, metres …
const SAME_PLACE_M: f64 = 0.08;
/// … and radians.
const SAME_PLACE_RAD: f64 = 0.03;
/// Beyond the ends of a segment it is followed until so many keyframes, one after the other, lie
/// where they belong, …
const RIGHT_MAX: usize = 2;
/// … so many say nothing, …
const SILENT_MAX: usize = 10;
/// … or so many were asked.
const FOLLOWED_MAX: usize = 60;

impl RouteMap {
    /// The segment of a mismatch of one trip.
    pub(super) fn segment_of(&self, mismatch: &Finding) -> Option<Segment> {
        let [trip] = mismatch.trips.as_slice() else {
            return None;
        };
        let places = self.places_of(trip, mismatch);
        let nodes = self.graph.nodes();
        let extent_m = spread_m(places.iter().map(|&k| nodes[k].pose.translation()));
        (!places.is_empty()).then(|| Segment {
            extent_m,
            places,
            trip: self.trips[trip].clone(),
            shift: mismatch.shift,
        })
    }

    /// What some keyframes of a segment, evenly chosen, say each for itself.
    pub(super) fn votes_of(&self, segment: &Segment) -> Vec<Said> {
        let chosen = evenly_chosen(&segment.places, KEYFRAMES_MAX);
        chosen
            .map(|&k| self.vote(segment, k, segment.shift.as_ref()))
            .collect()
    }

    /// Where a keyframe belongs, begun where a shift has it, by what older keyframes saw that are
    /// not of its segment.
    fn vote(&self, segment: &Segment, k: usize, shift: Option<&Vector2<f64>>) -> Said {
        let new = self.placed(k);
        let begin = new.pose.shifted(&shift.copied().unwrap_or_default());
        let window = Slack {
            distance_m: shift.map_or(WINDOW_UNKNOWN_M, |_| WINDOW_M),
            turn_rad: WINDOW_RAD,
            ..SLACK
        };
        let nearby = self.older_references(segment, k, &begin, window.distance_m);
        if nearby.is_empty() {
            return Said::Nothing;
        }
        let own = LocalMap::new(vec![(Pose2::IDENTITY, new.keyframe.points.as_slice())]);
        let Some(found) = anchor::relocate(&own, &nearby, &begin, &window) else {
            return Said::Nothing;
        };
        let expected = Placed { pose: found, ..new };
        let chosen = partners::choose(&expected, &nearby);
        let matches = chosen
            .iter()
            .filter_map(|old| self.matched(old, &new, &found));
        agreeing(k, &new.pose, matches.collect(), shift.is_none())
    }

    /// A match of a keyframe with an older one: its place, `map_from_base`, what was measured, and
    /// by how much more of the scan fits than where the keyframe lies.
    fn matched(&self, old: &Placed<'_>, new: &Placed<'_>, found: &Pose2) -> Option<Match> {
        let old_from_new = old.pose.between(found);
        let measured = closure::measure(old, new, &old_from_new, &SLACK, &self.closure_rule)?;
        if measured.fixed_share < FIXED_SHARE_MIN {
            return None;
        }
        let there = measured.robust.pose;
        let here = closure::aligned_from(old, new, &old.pose.between(&new.pose))?;
        let gain = match is_same_place(&here.pose, &there) {
            true => f64::INFINITY,
            false => measured.robust.explained_share() - here.explained_share(),
        };
        Some(Match {
            partner: self.graph.node_position(old.keyframe.node)?,
            pose: old.pose.compose(&there),
            measured,
            gain,
        })
    }

    /// References round a pose that are older than the segment and not of its trip's stretch
    /// before, of the keyframe's layer if there are any.
    fn older_references(
        &self,
        segment: &Segment,
        k: usize,
        pose: &Pose2,
        window_m: f64,
    ) -> Vec<Placed<'_>> {
        let first = segment.places[0];
        let begins = segment.trip.iter().position(|place| *place == first);
        let begins = begins.unwrap_or_default();
        let recent = &segment.trip[begins.saturating_sub(RECENT_KEYFRAMES)..begins];
        let within_m = PARTNER_DISTANCE_MAX_M + window_m;
        let nodes = self.graph.nodes();
        let older = (0..first).filter(|&other| {
            self.is_reference_with_scan(other)
                && !recent.contains(&other)
                && !self.is_lost(other)
                && (nodes[other].pose.translation() - pose.translation()).norm() <= within_m
        });
        self.of_layer_first(
            self.keyframes[k].layer(),
            older.map(|other| self.placed(other)).collect(),
        )
    }

    /// The verdict on a segment with the keyframes of its trip beyond both ends that belong
    /// elsewhere by the same shift.
    pub(super) fn followed_outwards(&self, verdict: Verdict, segment: &Segment) -> Verdict {
        let at = |place: Option<&usize>| {
            let place = *place?;
            segment.trip.iter().position(|k| *k == place)
        };
        let (Some(first), Some(last)) = (at(segment.places.first()), at(segment.places.last()))
        else {
            return verdict;
        };
        let mut verdict = verdict;
        if verdict.shift.norm() > SAME_PLACE_M {
            let before: Vec<usize> = segment.trip[..first].iter().rev().copied().collect();
            let mut ahead = self.followed(&before, segment, &mut verdict);
            ahead.reverse();
            let behind = self.followed(&segment.trip[last + 1..], segment, &mut verdict);
            verdict.places = [ahead, segment.places.clone(), behind].concat();
        }
        verdict
    }

    /// How far a segment goes on along some keyframes, the nearest first; what they say joins the
    /// votes. Beyond the last that votes for it those belong to it, up to the first that lies where
    /// it belongs, that do not lean towards where they lie.
    fn followed(&self, along: &[usize], segment: &Segment, verdict: &mut Verdict) -> Vec<usize> {
        let (mut right, mut silent, mut followed) = (0, 0, 0);
        let mut first_right = 0;
        for (n, &k) in along.iter().enumerate().take(FOLLOWED_MAX) {
            match self.vote(segment, k, Some(&verdict.shift)) {
                Said::Elsewhere(vote) if verdict.is_agreed_by(&vote) => {
                    (right, silent, followed) = (0, 0, n + 1);
                    verdict.votes.push(vote);
                }
                Said::Elsewhere(_) | Said::Here => {
                    first_right = if right == 0 { n } else { first_right };
                    (right, silent) = (right + 1, 0);
                }
                Said::Nothing => silent += 1,
            }
            if right >= RIGHT_MAX || silent >= SILENT_MAX {
                break;
            }
        }
        let between = followed..first_right.max(followed);
        let leaning = between.take_while(|&n| self.leans(segment, along[n], &verdict.shift));
        let leaning = leaning.count();
        along[..followed + leaning].to_vec()
    }

    /// Whether what an older keyframe saw speaks more for a place that is shifted than for where a
    /// keyframe lies, or for neither.
    fn leans(&self, segment: &Segment, k: usize, shift: &Vector2<f64>) -> bool {
        let new = self.placed(k);
        let there = Placed {
            pose: new.pose.shifted(shift),
            ..new
        };
        let nearby = self.older_references(segment, k, &there.pose, 0.0);
        let partners = partners::choose(&there, &nearby);
        let leans = partners.first().and_then(|old| {
            let begun_at = |pose: &Pose2| closure::aligned_from(old, &new, &old.pose.between(pose));
            let (here, there) = (begun_at(&new.pose)?, begun_at(&there.pose)?);
            if !is_same_place(&here.pose, &there.pose) {
                return Some(there.explained_share() >= here.explained_share() + GAIN_MIN);
            }
            let moved = old.pose.compose(&there.pose).translation() - new.pose.translation();
            Some((moved - shift).norm() < moved.norm())
        });
        leans.unwrap_or(true)
    }
}

/// A match of a keyframe.
struct Match {
    partner: usize,
    pose: Pose2,
    measured: ClosureMeasurement,
    gain: f64,
}

/// What a keyframe says by its matches: all must end in one place. Of one that is tied to nothing
/// it is news, too, that it lies where it belongs.
fn agreeing(place: usize, lies: &Pose2, matches: Vec<Match>, is_untied: bool) -> Said {
    let Some(best) = matches.iter().max_by(|a, b| {
        a.measured
            .robust
            .explained_share()
            .total_cmp(&b.measured.robust.explained_share())
    }) else {
        return Said::Nothing;
    };
    if !matches
        .iter()
        .all(|other| is_same_place(&other.pose, &best.pose))
    {
        return Said::Nothing;
    }
    let pose = best.pose;
    let fits_here = matches.iter().any(|found| found.gain < GAIN_MIN);
    if fits_here || (is_same_place(&pose, lies) && !is_untied) {
        return Said::Here;
    }
    Said::Elsewhere(Vote {
        place,
        pose,
        moved: pose.translation() - lies.translation(),
        turned_rad: wrap_angle(pose.theta - lies.theta),
        closures: matches
            .into_iter()
            .map(|found| (found.partner, found.measured))
            .collect(),
    })
}

fn is_same_place(a: &Pose2, b: &Pose2) -> bool {
    (a.translation() - b.translation()).norm() <= SAME_PLACE_M
        && angle_difference_rad(a.theta, b.theta) <= SAME_PLACE_RAD
}
