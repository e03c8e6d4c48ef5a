//! What a detector's open alerts say of the objects that were drawn.

use serde::Serialize;

use super::alert::ScoredAlert;
use super::distance::region_distance_m;
use super::drawn::DrawnObject;
use super::labels::Label;
use super::wilson::Share;
use crate::change::{ChangeKind, Tier};

/// An alert reports an object of its kind within this distance of its region, metres …
const REACH_M: f64 = 0.35;
/// … or this, where the lidar's noise is more than [`NOISY_SIGMA_M`].
const REACH_NOISY_M: f64 = 0.5;
const NOISY_SIGMA_M: f64 = 0.02;
/// An alert of kind `residual` says neither what changed nor where: it reports whatever object or
/// label is within this distance of its region, metres.
const RESIDUAL_REACH_M: f64 = 1.0;
/// An alert that the untouched recordings raise this near is none of the objects', metres.
const UNTOUCHED_M: f64 = 0.5;
/// An alert reports a labelled change this near, metres.
const LABEL_M: f64 = 0.5;

/// How far an alert may be from what it reports, metres.
pub(super) fn reach_m(range_sigma_m: f64) -> f64 {
    if range_sigma_m > NOISY_SIGMA_M {
        REACH_NOISY_M
    } else {
        REACH_M
    }
}

/// A detector's score on some seeds.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Score {
    /// Seeds that were run.
    pub seeds: usize,
    /// Objects that were found.
    pub found: Share,
    /// Those of them by a confirmed alert …
    pub confirmed: usize,
    /// … and by a tentative one.
    pub tentative: usize,
    /// Distances from alerts to the objects' middles, metres.
    pub location_errors_m: Vec<f64>,
    /// Passes that had shown each object's new state when its alert was raised.
    pub passes_when_raised: Vec<usize>,
    /// Alerts that report an object.
    pub true_alerts: usize,
    /// Alerts near no object that the untouched recordings do not raise either.
    pub false_alerts: usize,
    /// Alerts near an object that are not of its kind, and not of the untouched recordings.
    pub other_kind_alerts: usize,
    /// Scans that were given.
    pub scans: usize,
    /// CPU time, seconds.
    pub cpu_s: f64,
    /// Batches that never found a place in the map …
    pub batches_not_merged: usize,
    /// … of all of these.
    pub batches: usize,
}

impl Score {
    /// True alerts of those that are true or false.
    pub fn precision(&self) -> Share {
        Share {
            hits: self.true_alerts,
            of: self.true_alerts + self.false_alerts,
        }
    }

    /// The harmonic mean of precision and recall.
    pub fn f_score(&self) -> Option<f64> {
        let (precision, recall) = (self.precision().value()?, self.found.value()?);
        let sum = precision + recall;
        (sum > 0.0).then(|| 2.0 * precision * recall / sum)
    }

    /// CPU time for each scan, milliseconds.
    pub fn cpu_ms_per_scan(&self) -> f64 {
        1e3 * self.cpu_s / self.scans.max(1) as f64
    }

    /// Adds what was judged of one seed.
    pub(super) fn add(&mut self, judged: &Judged, alerts: &[ScoredAlert], objects: &[DrawnObject]) {
        self.seeds += 1;
        self.found.of += objects.len();
        for (object, found) in objects.iter().zip(&judged.found_by) {
            let Some(alert) = found.map(|k| &alerts[k]) else {
                continue;
            };
            self.found.hits += 1;
            match alert.tier {
                Some(Tier::Confirmed) => self.confirmed += 1,
                Some(Tier::Tentative) => self.tentative += 1,
                None => {}
            }
            if may_report(alert.kind, object.kind) {
                let error = alert.location - object.centre();
                self.location_errors_m.push(error.norm());
            }
            self.passes_when_raised.extend(alert.passes_when_raised);
        }
        let count = |verdict: Verdict| judged.verdicts.iter().filter(|v| **v == verdict).count();
        self.true_alerts += count(Verdict::True);
        self.false_alerts += count(Verdict::False);
        self.other_kind_alerts += count(Verdict::OtherKind);
    }
}

/// What an alert turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Verdict {
    /// It reports an object.
    True,
    /// It is near one, but not of its kind.
    OtherKind,
    /// The untouched recordings raise it too, or it reports one of their labelled changes.
    Untouched,
    /// Neither.
    False,
}

/// One seed's alerts against its objects.
#[derive(Debug, Clone)]
pub(super) struct Judged {
    /// For each object the nearest alert that reports it, as a place among the alerts.
    pub found_by: Vec<Option<usize>>,
    /// For each alert.
    pub verdicts: Vec<Verdict>,
}

/// Judges open alerts.
pub(super) fn judge(
    alerts: &[ScoredAlert],
    objects: &[DrawnObject],
    untouched: &[ScoredAlert],
    labels: &[Label],
    reach_m: f64,
) -> Judged {
    let found_by = objects.iter().map(|object| {
        let reporting = alerts.iter().enumerate().filter_map(|(k, alert)| {
            let gap_m = gap_m(alert, object, Some(object.kind));
            (gap_m <= reach_of(alert, reach_m))
                .then_some((k, (gap_m, (alert.location - object.centre()).norm())))
        });
        let nearest =
            reporting.min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        nearest.map(|(k, _)| k)
    });
    let near = |alert: &ScoredAlert, of_kind: bool| {
        objects.iter().any(|object| {
            gap_m(alert, object, of_kind.then_some(object.kind)) <= reach_of(alert, reach_m)
        })
    };
    let is_of_untouched = |alert: &ScoredAlert| {
        untouched
            .iter()
            .any(|other| alert.repeats(other, UNTOUCHED_M))
            || labels.iter().any(|label| reports(alert, label))
    };
    let verdict = |alert: &ScoredAlert| {
        if near(alert, true) {
            Verdict::True
        } else if is_of_untouched(alert) {
            Verdict::Untouched
        } else if near(alert, false) {
            Verdict::OtherKind
        } else {
            Verdict::False
        }
    };
    Judged {
        found_by: found_by.collect(),
        verdicts: alerts.iter().map(verdict).collect(),
    }
}

/// From the nearest side of an alert (of a kind, if one is asked for) to an object, metres.
fn gap_m(alert: &ScoredAlert, object: &DrawnObject, kind: Option<ChangeKind>) -> f64 {
    alert
        .sides()
        .filter(|(side, _)| kind.is_none_or(|kind| may_report(*side, kind)))
        .map(|(_, region)| region_distance_m(&object.shape, region))
        .fold(f64::INFINITY, f64::min)
}

/// Whether a side that shows one kind may be a change of another.
fn may_report(side: ChangeKind, kind: ChangeKind) -> bool {
    side == kind || side == ChangeKind::Residual
}

/// How far an alert may be from what it reports, given how far those of a kind of state may,
/// metres.
fn reach_of(alert: &ScoredAlert, reach_m: f64) -> f64 {
    match alert.kind {
        ChangeKind::Residual => RESIDUAL_REACH_M,
        _ => reach_m,
    }
}

fn reports(alert: &ScoredAlert, label: &Label) -> bool {
    alert.reports(label.kind, &label.location, LABEL_M)
        || alert.reports(ChangeKind::Residual, &label.location, RESIDUAL_REACH_M)
}

/// For each label whether an alert reports it, and for each alert whether a label explains it.
pub(super) fn against_labels(alerts: &[ScoredAlert], labels: &[Label]) -> (Vec<bool>, Vec<bool>) {
    let found = labels
        .iter()
        .map(|label| alerts.iter().any(|a| reports(a, label)));
    let explained = alerts
        .iter()
        .map(|alert| labels.iter().any(|l| reports(alert, l)));
    (found.collect(), explained.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::{Counterpart, region_round};
    use crate::geometry::Vector2;
    use crate::ids::StampNs;
    use crate::sim::Shape;

    fn alert(kind: ChangeKind, x: f64, y: f64) -> ScoredAlert {
        let location = Vector2::new(x, y);
        ScoredAlert {
            kind,
            location,
            region: region_round(&[location], 0.1),
            counterpart: None,
            tier: Some(Tier::Confirmed),
            passes_when_raised: Some(2),
            batch_when_raised: Some(7),
            since: StampNs(0),
        }
    }

    fn object(kind: ChangeKind, x: f64, y: f64) -> DrawnObject {
        DrawnObject {
            shape: Shape::Round {
                centre: Vector2::new(x, y),
                radius_m: 0.2,
            },
            kind,
            moment: StampNs(0),
        }
    }

    #[test]
    fn alerts_made_by_hand_are_judged() {
        use ChangeKind::{Appeared, Disappeared, MapMismatch};
        let objects = [
            object(Appeared, 0.0, 0.0),
            object(Disappeared, 5.0, 0.0),
            object(Disappeared, 10.0, 0.0),
        ];
        let mut door = alert(Appeared, 10.9, 0.0);
        door.counterpart = Some(Counterpart {
            kind: Disappeared,
            region: region_round(&[Vector2::new(10.1, 0.0)], 0.1),
        });
        let alerts = [
            alert(Appeared, 0.55, 0.0),
            alert(Appeared, 0.2, 0.0),
            alert(Appeared, 5.0, 0.3),
            door,
            alert(MapMismatch, 20.0, 0.0),
            alert(Appeared, 30.0, 0.0),
            alert(Appeared, 40.0, 0.0),
            alert(Appeared, 50.0, 0.0),
        ];
        let untouched = [alert(Appeared, 30.4, 0.0), alert(Disappeared, 40.0, 0.0)];
        let labels = [Label {
            location: Vector2::new(50.4, 0.0),
            kind: Appeared,
            what: String::new(),
        }];
        let judged = judge(&alerts, &objects, &untouched, &labels, reach_m(0.01));
        assert_eq!(judged.found_by, [Some(1), None, Some(3)]);
        use Verdict::{False, OtherKind, True, Untouched};
        let expected = [
            True, True, OtherKind, True, False, Untouched, False, Untouched,
        ];
        assert_eq!(judged.verdicts, expected);
        let mut score = Score::default();
        score.add(&judged, &alerts, &objects);
        assert_eq!(score.found, Share { hits: 2, of: 3 });
        assert_eq!((score.true_alerts, score.false_alerts), (3, 2));
        assert_eq!((score.confirmed, score.passes_when_raised), (2, vec![2, 2]));
        assert_eq!(score.location_errors_m, [0.2]);
        assert_eq!(score.other_kind_alerts, 1);
        let f = 2.0 * 0.6 * (2.0 / 3.0) / (0.6 + 2.0 / 3.0);
        let score_f = Score {
            found: score.found,
            true_alerts: 3,
            false_alerts: 2,
            ..Score::default()
        };
        assert!((score_f.f_score().unwrap() - f).abs() < 1e-12);
    }

    #[test]
    fn a_residual_reports_any_object_within_a_metre_and_no_other() {
        use ChangeKind::{Appeared, Disappeared, Residual};
        let objects = [object(Appeared, 0.0, 0.0), object(Disappeared, 5.0, 0.0)];
        // From the side of the region, 0.1 m from its middle, to the object's, 0.2 m from its own.
        let alerts = [
            alert(Residual, 1.25, 0.0),
            alert(Residual, 6.25, 0.0),
            alert(Residual, 5.0, 1.4),
        ];
        let judged = judge(&alerts, &objects, &[], &[], reach_m(0.01));
        assert_eq!(judged.found_by, [Some(0), Some(1)]);
        use Verdict::{False, True};
        assert_eq!(judged.verdicts, [True, True, False]);
        let mut score = Score::default();
        score.add(&judged, &alerts, &objects);
        assert_eq!((score.true_alerts, score.false_alerts), (2, 1));
        assert_eq!(score.location_errors_m, [1.25, 1.25]);
        // As far off, an alert that says what changed reports nothing.
        let says_what = [alert(Appeared, 1.25, 0.0)];
        let judged = judge(&says_what, &objects, &[], &[], reach_m(0.01));
        assert_eq!(judged.verdicts, [False]);
    }

    #[test]
    fn noisy_lidars_reach_farther() {
        let alerts = [alert(ChangeKind::Appeared, 0.75, 0.0)];
        let objects = [object(ChangeKind::Appeared, 0.0, 0.0)];
        let found = |sigma_m: f64| judge(&alerts, &objects, &[], &[], reach_m(sigma_m)).found_by[0];
        assert_eq!(found(0.01), None);
        assert_eq!(found(0.03), Some(0));
    }

    #[test]
    fn labels_are_found_by_their_kind() {
        let label = |kind, x| Label {
            location: Vector2::new(x, 0.0),
            kind,
            what: String::new(),
        };
        let alerts = [
            alert(ChangeKind::Appeared, 0.0, 0.0),
            alert(ChangeKind::Appeared, 9.0, 0.0),
        ];
        let labels = [
            label(ChangeKind::Appeared, 0.5),
            label(ChangeKind::Disappeared, 0.0),
            label(ChangeKind::Appeared, 0.7),
        ];
        let (found, explained) = against_labels(&alerts, &labels);
        assert_eq!(found, [true, false, false]);
        assert_eq!(explained, [true, false]);
    }
}
