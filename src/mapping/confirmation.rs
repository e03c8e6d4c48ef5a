//! Whether scans show the place that a search found for them, one by one.

use super::closure::{
    self, CONTRADICTION_SHARE_MAX, CONTRADICTION_SHARE_MAX_FROM_AFAR, ClosureRule, Slack,
};
use super::partners::{self, PARTNER_DISTANCE_MAX_M, Placed};
use crate::calibration::median;
use crate::geometry::Pose2;

/// Fewest keyframes by which a place is found.
pub(super) const KEYFRAMES_MIN: usize = 4;
/// Most points of the scans that a search compares with a place.
pub(super) const POINTS_MAX: usize = 300;

/// How a place is looked for, and what the scans must show at the one that looks most like theirs.
pub(super) struct Confirmation {
    /// Edge of a cell of the search, metres, …
    pub resolution_m: f64,
    /// … and points that are compared.
    pub points_max: usize,
    /// Least share of the points' score that a place must reach.
    pub score_min: f64,
    /// Another place is one like it if it reaches this share of its score, …
    pub rival_share: f64,
    /// … or if the scans confirm it too, and it leaves at most so many times as many points
    /// unexplained, as shares: one minus the score. 1 if only scores count.
    pub rival_unexplained_ratio: f64,
    slack: Slack,
    /// Of the compared scans so many must agree, …
    agreeing_min: usize,
    /// … and this share of them, …
    agreeing_share_min: f64,
    /// … and these contradict what they agree with by no more than this share of the points (median).
    contradiction_median_max: f64,
}

/// For a trip that begins. No other place is like the one found, so a match that ends there is
/// believed although much of the place has changed.
pub(super) const TRUSTING: Confirmation = Confirmation {
    resolution_m: 0.1,
    points_max: POINTS_MAX,
    score_min: 0.4,
    rival_share: 0.9,
    // Where much has changed, a wrong place may explain a little more than the right one by chance.
    rival_unexplained_ratio: 4.0 / 3.0,
    slack: Slack {
        distance_m: 0.8,
        turn_rad: 0.3,
        well_known: true,
        contradiction_share_max: CONTRADICTION_SHARE_MAX,
    },
    agreeing_min: KEYFRAMES_MIN,
    agreeing_share_min: 0.6,
    contradiction_median_max: 1.0,
};

/// For a trip that was lost, perhaps where the map has nothing to tell the place from others: it
/// can wait until it has driven on. It is searched for again and again, so coarsely.
pub(super) const STRICT: Confirmation = Confirmation {
    resolution_m: 0.2,
    points_max: 150,
    score_min: TRUSTING.score_min,
    rival_share: 0.8,
    rival_unexplained_ratio: 1.0,
    slack: Slack {
        well_known: false,
        contradiction_share_max: CONTRADICTION_SHARE_MAX_FROM_AFAR,
        ..TRUSTING.slack
    },
    agreeing_min: KEYFRAMES_MIN,
    agreeing_share_min: 0.9,
    contradiction_median_max: CONTRADICTION_MEDIAN_MAX,
};

/// For a lost trip of few keyframes: a short part of a corridor fits well in many places, so it must
/// fit nearly everywhere.
pub(super) const BRIEF: Confirmation = Confirmation {
    score_min: 0.92,
    ..STRICT
};

/// For a trip that comes from afar, by what it saw on its last metres: a lap may end where it only
/// touches what it saw first. On `infinite` right places contradict by up to 0.05: where they were
/// refused for that, loops stayed open.
pub(super) const FROM_AFAR: Confirmation = Confirmation {
    agreeing_min: 2,
    contradiction_median_max: 1.0,
    ..STRICT
};

/// Scans that agree with a place one by one may all contradict it a little, where corridors and doors
/// repeat: by 0.04 to 0.1 in simulation, at the right place by less than 0.01. The median of such
/// shares is no larger than this at the right place, unless it has changed.
const CONTRADICTION_MEDIAN_MAX: f64 = 0.03;
/// Of two places the scans do not show the one that they contradict more than that, and so many times
/// as much as the other, …
const REFUTED_CONTRAST_MIN: f64 = 4.0;
/// … nor one that so few of them agree with, as a share.
const REFUTED_SHARE_MAX: f64 = 0.3;

/// Whether the trip's scans show the place found; if not, how many do.
pub(super) fn confirm(
    references: &[Placed<'_>],
    own: &[Placed<'_>],
    map_from_own: &Pose2,
    confirmation: &Confirmation,
) -> Result<(), Count> {
    let count = agreeing(references, own, map_from_own, confirmation);
    match count.confirms(own.len(), confirmation) {
        true => Ok(()),
        false => Err(count),
    }
}

/// Compares each of the trip's scans with its partners at a place.
fn agreeing(
    references: &[Placed<'_>],
    own: &[Placed<'_>],
    map_from_own: &Pose2,
    confirmation: &Confirmation,
) -> Count {
    let mut count = Count::default();
    for keyframe in own {
        match compare(references, keyframe, map_from_own, confirmation) {
            Some(Comparison::Agrees(contradiction_share)) => {
                count.compared += 1;
                count.contradiction_shares.push(contradiction_share);
            }
            Some(Comparison::Differs) => count.compared += 1,
            None => {}
        }
    }
    count
}

/// What a scan says of a place.
#[derive(Debug, Clone, Copy)]
pub(super) enum Comparison {
    /// It shows what a partner there does, but for this share of the points, which lie in the free
    /// space of the other scan.
    Agrees(f64),
    /// It does not.
    Differs,
}

/// Compares a scan with its partners at a place; `None` if it has none.
pub(super) fn compare(
    references: &[Placed<'_>],
    own: &Placed<'_>,
    map_from_own: &Pose2,
    confirmation: &Confirmation,
) -> Option<Comparison> {
    let expected = Placed {
        pose: map_from_own.compose(&own.pose),
        ..*own
    };
    let (slack, rule) = (&confirmation.slack, ClosureRule::default());
    let nearby = partners::within(PARTNER_DISTANCE_MAX_M, &expected.pose, references);
    let chosen = partners::choose(&expected, &nearby);
    let fit = chosen.iter().find_map(|old| {
        let old_from_new = old.pose.between(&expected.pose);
        closure::fit(old, &expected, &old_from_new, slack, &rule)
    });
    let says = match fit {
        Some(fit) => Comparison::Agrees(fit.contradiction_share),
        None => Comparison::Differs,
    };
    (!chosen.is_empty()).then_some(says)
}

/// Which of two places that look alike from afar the scans show, one by one: nearly all agree with
/// it, and few with the other, or not without contradicting it.
pub(super) fn distinguished(
    references: &[Placed<'_>],
    own: &[Placed<'_>],
    places: [&Pose2; 2],
    confirmation: &Confirmation,
) -> Option<Pose2> {
    let strict = Confirmation {
        contradiction_median_max: confirmation.contradiction_median_max,
        ..STRICT
    };
    let counts = places.map(|place| agreeing(references, own, place, &strict));
    let is_shown = |count: &Count, other: &Count| {
        count.confirms(own.len(), &strict) && other.is_refuted_beside(count)
    };
    match &counts {
        [here, there] if is_shown(here, there) => Some(*places[0]),
        [there, here] if is_shown(here, there) => Some(*places[1]),
        _ => None,
    }
}

/// How many scans agree with a place.
#[derive(Debug, Default)]
pub(super) struct Count {
    /// Scans that were compared …
    pub compared: usize,
    /// … and how much those of them that agree contradict what they agree with, as shares of the
    /// points.
    contradiction_shares: Vec<f64>,
}

impl Count {
    /// Scans that a closer match confirms.
    pub fn agreeing(&self) -> usize {
        self.contradiction_shares.len()
    }

    /// Whether they confirm the place of so many keyframes.
    fn confirms(&self, keyframes: usize, confirmation: &Confirmation) -> bool {
        self.agreeing() >= confirmation.agreeing_min.min(keyframes)
            && self.agreeing() as f64 >= confirmation.agreeing_share_min * self.compared as f64
            && self.contradiction_median() <= confirmation.contradiction_median_max
    }

    /// Whether the scans do not show this place, while they show another.
    fn is_refuted_beside(&self, shown: &Self) -> bool {
        let as_shown = REFUTED_CONTRAST_MIN * shown.contradiction_median();
        let contradicts = self.contradiction_median() > CONTRADICTION_MEDIAN_MAX.max(as_shown);
        let few_agree = self.agreeing() as f64 <= REFUTED_SHARE_MAX * self.compared as f64;
        self.compared > 0 && (few_agree || contradicts)
    }

    fn contradiction_median(&self) -> f64 {
        median(self.contradiction_shares.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(compared: usize, contradiction_shares: &[f64]) -> Count {
        Count {
            compared,
            contradiction_shares: contradiction_shares.to_vec(),
        }
    }

    #[test]
    fn a_place_that_every_scan_contradicts_a_little_is_not_the_one() {
        let shown = count(5, &[0.0, 0.01, 0.09, 0.0, 0.0]);
        let alike = count(5, &[0.05, 0.06, 0.09, 0.05, 0.04]);
        assert!(shown.confirms(5, &STRICT) && !alike.confirms(5, &STRICT));
        assert!(alike.is_refuted_beside(&shown) && !shown.is_refuted_beside(&alike));
        // Where much has changed a trip that begins may contradict more, if nothing else is like it.
        assert!(alike.confirms(5, &TRUSTING));
    }

    #[test]
    fn two_places_that_are_contradicted_alike_remain_two() {
        let [here, there] = [count(4, &[0.02; 4]), count(4, &[0.06; 4])];
        assert!(!there.is_refuted_beside(&here) && !here.is_refuted_beside(&there));
        let nowhere = count(0, &[]);
        assert!(!nowhere.is_refuted_beside(&here));
        assert!(count(5, &[0.0]).is_refuted_beside(&here));
    }
}
