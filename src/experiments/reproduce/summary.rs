//! All cases together.

use std::collections::BTreeMap;

use serde::Serialize;

use super::case::{Acceptance, Seeds};
use super::counts::{Counts, roc_area};
use super::mapped::Exclusion;
use super::method::{Method, PaperMap};
use super::paper_mode::PaperColumns;
use super::run_one::{Maps, Outcome};
use super::score::{Event, Score};
use crate::experiments::Share;

/// Bounds of the size classes, relative to the original objects' area.
pub(super) const SIZE_BOUNDS: [f64; 3] = [0.005, 0.01, 0.03];

/// All results.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    /// The set of seeds.
    pub seeds: Seeds,
    /// Whether only a few small cases were run.
    pub short: bool,
    /// Cases run.
    pub cases: usize,
    /// Laps in them.
    pub laps: usize,
    /// Closures of the maps.
    pub closures: Maps<usize>,
    /// By ρ, with the usual closure rule.
    pub levels: Vec<Level>,
    /// By closure rule.
    pub acceptances: Vec<AcceptanceRow>,
    /// Every case by itself.
    pub outcomes: Vec<Outcome>,
}

/// The cases of one ρ.
#[derive(Debug, Serialize)]
pub(super) struct Level {
    /// ρ, metres.
    pub path_noise_m: f64,
    /// By method, cases left out as the paper leaves them out.
    pub rows: BTreeMap<Method, Row>,
    /// Fused, with no case left out.
    pub fused_everywhere: Row,
    /// Table 1's columns at th: the median at changes, the largest without.
    pub paper_columns: BTreeMap<PaperMap, PaperColumns>,
}

/// A method's score over some cases.
#[derive(Debug, Default, Serialize)]
pub(super) struct Row {
    /// Cases scored.
    pub cases: usize,
    /// Cases left out, by reason.
    pub excluded: BTreeMap<Exclusion, usize>,
    /// Area under the ROC curve at closure level.
    pub roc_area: Option<f64>,
    /// Share of the visible changes that were found.
    pub events_found: Share,
    /// Share of the alerts that are true.
    pub alerts_true: Share,
    /// Of alerts and events.
    pub event_f_score: Option<f64>,
    /// Distance from the reported place to the object's middle, metres: the median and what nine of
    /// ten stay below.
    pub location_error_m: [Option<f64>; 2],
    /// Found events by laps until they were raised: 0, 1, 2 and more.
    pub laps_until_raised: [usize; 3],
    /// Found events by size class, from the smallest.
    pub by_size: [Share; 4],
    /// Counts at closure and lap level.
    #[serde(flatten)]
    pub score: Score,
}

/// Laps of the paper's rule under one closure rule.
#[derive(Debug, Serialize)]
pub(super) struct AcceptanceRow {
    /// How the map was made.
    pub map: PaperMap,
    /// The rule.
    pub acceptance: Acceptance,
    /// ρ, metres.
    pub path_noise_m: f64,
    /// Cases, those left out included.
    pub cases: usize,
    /// Cases left out.
    pub excluded: BTreeMap<Exclusion, usize>,
    /// Closures a lap.
    pub closures_per_lap: f64,
    /// Decisions about laps at th.
    pub laps: Counts,
    /// Decisions about closures at th.
    pub closures: Counts,
}

impl Summary {
    /// Of all outcomes, in the order of the protocol.
    pub(super) fn of(outcomes: Vec<Outcome>, seeds: Seeds, short: bool) -> Self {
        let mut noises_m: Vec<f64> = outcomes.iter().map(|o| o.case.path_noise_m).collect();
        noises_m.sort_by(f64::total_cmp);
        noises_m.dedup();
        let at = |noise_m: f64| {
            let at_level = outcomes
                .iter()
                .filter(move |o| o.case.path_noise_m == noise_m);
            at_level.collect::<Vec<&Outcome>>()
        };
        let closures = |of: fn(&Maps<usize>) -> usize| {
            let counts = outcomes.iter().map(|o| o.maps.each(|map| map.closures));
            counts.map(|counts| of(&counts)).sum()
        };
        Self {
            seeds,
            short,
            cases: outcomes.len(),
            laps: outcomes.iter().map(|o| o.case.laps()).sum(),
            closures: Maps {
                seed: closures(|maps| maps.seed),
                faithful: closures(|maps| maps.faithful),
                robust: closures(|maps| maps.robust),
            },
            levels: noises_m.iter().map(|&m| Level::of(m, &at(m))).collect(),
            acceptances: noises_m
                .iter()
                .flat_map(|&m| acceptances(m, &at(m)))
                .collect(),
            outcomes,
        }
    }

    /// A method's score over all ρ.
    pub(super) fn everywhere(&self, method: Method) -> Row {
        let usual = self.outcomes.iter().filter(|o| is_usual(o));
        Row::of(usual, method, true)
    }
}

fn is_usual(outcome: &Outcome) -> bool {
    outcome.case.acceptance == Acceptance::Medium
}

impl Level {
    fn of(path_noise_m: f64, outcomes: &[&Outcome]) -> Self {
        let usual = || outcomes.iter().copied().filter(|o| is_usual(o));
        let row = |method| (method, Row::of(usual(), method, true));
        let columns = |map| {
            let scored = usual().filter(|o| o.maps.of_paper(map).exclusion.is_none());
            let columns: Vec<PaperColumns> = scored.map(|o| o.paper_columns[&map]).collect();
            let changed: Vec<f64> = columns.iter().filter_map(|c| c.changed).collect();
            let unchanged = columns.iter().filter_map(|c| c.unchanged);
            let columns = PaperColumns {
                changed: quantile(changed, 0.5),
                unchanged: unchanged.max_by(f64::total_cmp),
            };
            (map, columns)
        };
        Self {
            path_noise_m,
            rows: Method::ALL.map(row).into(),
            fused_everywhere: Row::of(usual(), Method::Fused, false),
            paper_columns: PaperMap::ALL.map(columns).into(),
        }
    }
}

impl Row {
    fn of<'a>(
        outcomes: impl Iterator<Item = &'a Outcome>,
        method: Method,
        leave_out: bool,
    ) -> Self {
        let mut row = Self::default();
        for outcome in outcomes {
            match outcome.exclusion(method).filter(|_| leave_out) {
                Some(reason) => *row.excluded.entry(reason).or_default() += 1,
                None => {
                    row.cases += 1;
                    row.score.merge(&outcome.scores[&method]);
                }
            }
        }
        row.conclude();
        row
    }

    fn conclude(&mut self) {
        let score = &self.score;
        if let Some((changed, unchanged)) = &score.roc {
            self.roc_area = roc_area(changed, unchanged);
        }
        self.events_found = found(score.events.iter());
        self.alerts_true = Share {
            hits: score.true_alerts,
            of: score.true_alerts + score.false_alerts,
        };
        let both = (self.alerts_true.value(), self.events_found.value());
        self.event_f_score = match both {
            (Some(precision), Some(recall)) if precision + recall > 0.0 => {
                Some(2.0 * precision * recall / (precision + recall))
            }
            (_, Some(_)) => Some(0.0),
            _ => None,
        };
        let errors_m = score.events.iter().filter_map(|e| e.location_error_m);
        let errors_m: Vec<f64> = errors_m.collect();
        self.location_error_m = [0.5, 0.9].map(|share| quantile(errors_m.clone(), share));
        for laps in score.events.iter().filter_map(|e| e.laps_until_raised) {
            self.laps_until_raised[laps.min(2)] += 1;
        }
        let class = |event: &Event| {
            let above = SIZE_BOUNDS
                .iter()
                .filter(|bound| event.area_share >= **bound);
            above.count()
        };
        self.by_size = [0, 1, 2, 3].map(|k| found(score.events.iter().filter(|e| class(e) == k)));
    }
}

fn found<'a>(events: impl Iterator<Item = &'a Event>) -> Share {
    let mut share = Share::default();
    for event in events {
        share.of += 1;
        share.hits += usize::from(event.found);
    }
    share
}

/// A quantile of the values; `None` if there are none.
fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let place = (values.len() as f64 * share) as usize;
    values.get(place).copied()
}

/// The paper's rule under each closure rule, on cases of equal changes and laps.
fn acceptances(path_noise_m: f64, outcomes: &[&Outcome]) -> Vec<AcceptanceRow> {
    let swept = outcomes.iter().find(|o| !is_usual(o));
    let Some(changes) = swept.map(|o| o.case.changes) else {
        return Vec::new();
    };
    let row = |(map, acceptance)| {
        let of_rule = |o: &&&Outcome| o.case.acceptance == acceptance && o.case.changes == changes;
        let cases: Vec<&&Outcome> = outcomes.iter().filter(of_rule).collect();
        let score = Row::of(cases.iter().map(|o| **o), Method::Paper(map), true);
        let closures = cases.iter().map(|o| o.maps.of_paper(map).closures);
        let closures: usize = closures.sum();
        let laps: usize = cases.iter().map(|o| o.case.laps()).sum();
        AcceptanceRow {
            map,
            acceptance,
            path_noise_m,
            cases: cases.len(),
            excluded: score.excluded,
            closures_per_lap: closures as f64 / laps.max(1) as f64,
            laps: score.score.laps,
            closures: score.score.closures,
        }
    };
    let rules = [Acceptance::Low, Acceptance::Medium, Acceptance::High];
    let maps = PaperMap::ALL.into_iter();
    maps.flat_map(|map| rules.map(|rule| row((map, rule))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::ChangeKind;

    fn event(area_share: f64, raised: Option<usize>) -> Event {
        Event {
            kind: ChangeKind::Appeared,
            place: [0.0, 0.0],
            area_share,
            found: raised.is_some(),
            laps_until_raised: raised,
            location_error_m: raised.map(|laps| 0.1 * laps as f64),
        }
    }

    #[test]
    fn a_row_concludes_what_its_events_say() {
        let mut row = Row::default();
        row.score.events = vec![
            event(0.001, None),
            event(0.007, Some(0)),
            event(0.02, Some(1)),
            event(0.05, Some(4)),
        ];
        (row.score.true_alerts, row.score.false_alerts) = (3, 1);
        row.conclude();
        assert_eq!(row.events_found, Share { hits: 3, of: 4 });
        assert_eq!(row.event_f_score, Some(0.75));
        assert_eq!(row.laps_until_raised, [1, 1, 1]);
        assert_eq!(row.location_error_m, [Some(0.1), Some(0.4)]);
        let found: Vec<usize> = row.by_size.iter().map(|share| share.hits).collect();
        assert_eq!(found, [0, 1, 1, 1]);
    }

    #[test]
    fn without_alerts_the_score_is_nothing_and_without_events_there_is_none() {
        let mut row = Row::default();
        row.conclude();
        assert_eq!(row.event_f_score, None);
        row.score.events = vec![event(0.01, None)];
        row.conclude();
        assert_eq!(row.event_f_score, Some(0.0));
    }
}
