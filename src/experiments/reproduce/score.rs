//! Scores what a method reported in a case against the truth.

use serde::Serialize;

use super::counts::Counts;
use super::laps::{Laps, TrueChange};
use super::mapped::Mapped;
use super::method::{Judged, LAPS_LEARNT, Raised, Reported};
use crate::change::ChangeKind;
use crate::experiments::Share;
use crate::experiments::region_distance_m;
use crate::geometry::Vector2;

/// A closure is changed if the change shows in more than this share of a scan's beams, and
/// unchanged if it shows in none; what lies between is not scored.
const CHANGED_SHARE: f64 = 0.03;
/// A region reports a change of its kind within this distance, metres.
const REGION_DISTANCE_M: f64 = 0.35;

/// A method's score in one case, or in several.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Score {
    /// Decisions about closures.
    pub closures: Counts,
    /// Closures not scored: the change shows in some beams, but in too few.
    pub closures_between: usize,
    /// Closures not judged: the map was being learnt.
    pub closures_not_judged: usize,
    /// Scores of the changed and the unchanged closures.
    #[serde(skip)]
    pub roc: Option<(Vec<f64>, Vec<f64>)>,
    /// Decisions about laps: the first changed lap, and those without any change.
    pub laps: Counts,
    /// Later changed laps in which something was reported.
    pub laps_later: Share,
    /// Laps not scored: nothing of the change could be seen.
    pub laps_unseen: usize,
    /// Laps not judged: the map was being learnt.
    pub laps_not_judged: usize,
    /// The visible changes.
    pub events: Vec<Event>,
    /// Alerts that report a true change.
    pub true_alerts: usize,
    /// Alerts that do not.
    pub false_alerts: usize,
    /// Where those are, map frame, metres.
    pub false_alert_places: Vec<[f64; 2]>,
}

/// A visible change.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Event {
    /// Appeared or disappeared.
    pub kind: ChangeKind,
    /// The object's middle, map frame, metres.
    pub place: [f64; 2],
    /// Its area as a share of all original objects' area.
    pub area_share: f64,
    /// Whether an alert reports it.
    pub found: bool,
    /// Laps from the first that observes its place to the alert; 0 for the same lap.
    pub laps_until_raised: Option<usize>,
    /// From the place that was reported to the object's middle, metres.
    pub location_error_m: Option<f64>,
}

impl Score {
    /// Of one case.
    pub(super) fn of(laps: &Laps, mapped: &Mapped, judged: &Judged) -> Self {
        let mut score = Self::default();
        score.judge_closures(laps, mapped, judged);
        score.judge_laps(laps, mapped, judged);
        score.judge_events(laps, judged);
        score
    }

    /// Adds another case.
    pub(super) fn merge(&mut self, other: &Self) {
        self.closures.merge(&other.closures);
        self.closures_between += other.closures_between;
        self.closures_not_judged += other.closures_not_judged;
        if let Some((changed, unchanged)) = &other.roc {
            let both = self.roc.get_or_insert_default();
            both.0.extend(changed);
            both.1.extend(unchanged);
        }
        self.laps.merge(&other.laps);
        self.laps_later.hits += other.laps_later.hits;
        self.laps_later.of += other.laps_later.of;
        self.laps_unseen += other.laps_unseen;
        self.laps_not_judged += other.laps_not_judged;
        self.events.extend(&other.events);
        self.true_alerts += other.true_alerts;
        self.false_alerts += other.false_alerts;
        self.false_alert_places.extend(&other.false_alert_places);
    }

    fn judge_closures(&mut self, laps: &Laps, mapped: &Mapped, judged: &Judged) {
        let (mut changed, mut unchanged) = (Vec::new(), Vec::new());
        for (k, made) in mapped.closures.iter().enumerate() {
            let share = laps.changed_share(made.old, made.new);
            if !judged.judged[k] {
                self.closures_not_judged += 1;
            } else if share > 0.0 && share <= CHANGED_SHARE {
                self.closures_between += 1;
            } else {
                self.closures.add(share > 0.0, judged.reported[k]);
                if let Some(scores) = &judged.scores {
                    let side = if share > 0.0 {
                        &mut changed
                    } else {
                        &mut unchanged
                    };
                    side.push(scores[k]);
                }
            }
        }
        self.roc = judged.scores.is_some().then_some((changed, unchanged));
    }

    fn judge_laps(&mut self, laps: &Laps, mapped: &Mapped, judged: &Judged) {
        for lap in 0..laps.count {
            let closures = mapped.closures.iter().zip(&judged.judged);
            let is_judged =
                lap >= LAPS_LEARNT && { closures }.any(|(made, j)| *j && made.place.lap == lap);
            let reported = judged.raised.iter().any(|raised| raised.lap == lap);
            match lap_truth(laps, lap) {
                _ if !is_judged => self.laps_not_judged += 1,
                LapTruth::Unchanged => self.laps.add(false, reported),
                LapTruth::FirstChanged => self.laps.add(true, reported),
                LapTruth::Unseen => self.laps_unseen += 1,
                LapTruth::Later => {
                    self.laps_later.of += 1;
                    self.laps_later.hits += usize::from(reported);
                }
            }
        }
    }

    fn judge_events(&mut self, laps: &Laps, judged: &Judged) {
        let mut events: Vec<Event> = laps.changes.iter().map(unfound).collect();
        for raised in &judged.raised {
            let reported = changes_reported(laps, raised);
            if reported.is_empty() {
                self.false_alerts += 1;
                self.false_alert_places.push(place_of(raised));
            } else {
                self.true_alerts += 1;
            }
            for (change, error_m) in reported {
                let event = &mut events[change];
                // Alerts come in the order of closures: the first is the earliest.
                if !event.found {
                    let first = laps.changes[change].first_lap.unwrap_or(laps.before);
                    event.found = true;
                    event.laps_until_raised = Some(raised.lap.saturating_sub(first));
                    event.location_error_m = Some(error_m);
                }
            }
        }
        let visible = events.into_iter().zip(&laps.changes);
        self.events = visible.filter(|(_, c)| c.visible).map(|(e, _)| e).collect();
    }
}

fn place_of(raised: &Raised) -> [f64; 2] {
    match &raised.what {
        Reported::Closure { position, .. } => (*position).into(),
        Reported::Region { location, .. } => (*location).into(),
    }
}

fn unfound(change: &TrueChange) -> Event {
    Event {
        kind: change.kind,
        place: change.shape.bounding_circle().0.into(),
        area_share: change.area_share,
        found: false,
        laps_until_raised: None,
        location_error_m: None,
    }
}

enum LapTruth {
    Unchanged,
    FirstChanged,
    Later,
    Unseen,
}

fn lap_truth(laps: &Laps, lap: usize) -> LapTruth {
    if laps.changes.is_empty() || lap < laps.before {
        return LapTruth::Unchanged;
    }
    if !laps.changes.iter().any(|change| change.visible) {
        return LapTruth::Unseen;
    }
    if lap > laps.before {
        return LapTruth::Later;
    }
    let looks = |k: &usize| laps.changes[*k].visible;
    let mut scans = laps.scans.iter().filter(|scan| scan.lap == lap);
    match scans.any(|scan| scan.observes.iter().any(looks)) {
        true => LapTruth::FirstChanged,
        false => LapTruth::Unseen,
    }
}

/// The changes that an alert reports, with its distance from the centre of each, metres.
///
/// A closure reports every change that one of its two scans observes, if the world changed between them; a
/// region reports the changes of its kind that it touches.
fn changes_reported(laps: &Laps, raised: &Raised) -> Vec<(usize, f64)> {
    match &raised.what {
        Reported::Closure { old, new, position } => {
            if !laps.crosses_change(*old, *new) {
                return Vec::new();
            }
            let seen = |k: &usize| {
                [*old, *new]
                    .iter()
                    .any(|s| laps.scans[*s].observes.contains(k))
            };
            let error_m = |k: usize| (k, from_middle_m(&laps.changes[k], position));
            (0..laps.changes.len()).filter(seen).map(error_m).collect()
        }
        Reported::Region {
            kind,
            location,
            region,
        } => {
            let touches = |(_, change): &(usize, &TrueChange)| {
                change.kind == *kind
                    && raised.lap >= laps.before
                    && region_distance_m(&change.shape, region) <= REGION_DISTANCE_M
            };
            let changes = laps.changes.iter().enumerate().filter(touches);
            changes
                .map(|(k, change)| (k, from_middle_m(change, location)))
                .collect()
        }
    }
}

fn from_middle_m(change: &TrueChange, place: &Vector2<f64>) -> f64 {
    (change.shape.bounding_circle().0 - place).norm()
}

#[cfg(test)]
mod tests;
