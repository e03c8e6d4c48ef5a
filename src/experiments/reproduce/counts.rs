//! How often a decision was right.

use serde::Serialize;

use crate::experiments::Share;

/// Decisions by what was decided and what was true.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub(super) struct Counts {
    /// Changed and reported.
    pub found: usize,
    /// Changed and not reported.
    pub missed: usize,
    /// Unchanged, but reported as changed.
    pub false_alarms: usize,
    /// Unchanged, and left alone.
    pub left_alone: usize,
}

impl Counts {
    /// Counts one decision.
    pub(super) fn add(&mut self, changed: bool, reported: bool) {
        *match (changed, reported) {
            (true, true) => &mut self.found,
            (true, false) => &mut self.missed,
            (false, true) => &mut self.false_alarms,
            (false, false) => &mut self.left_alone,
        } += 1;
    }

    /// Adds another's counts.
    pub(super) fn merge(&mut self, other: &Self) {
        self.found += other.found;
        self.missed += other.missed;
        self.false_alarms += other.false_alarms;
        self.left_alone += other.left_alone;
    }

    /// Share of the reports that are true.
    pub(super) fn precision(&self) -> Share {
        Share {
            hits: self.found,
            of: self.found + self.false_alarms,
        }
    }

    /// Share of the true changes that were reported.
    pub(super) fn recall(&self) -> Share {
        Share {
            hits: self.found,
            of: self.found + self.missed,
        }
    }

    /// Share of what was unchanged that was reported as changed.
    pub(super) fn false_alarm_rate(&self) -> Share {
        Share {
            hits: self.false_alarms,
            of: self.false_alarms + self.left_alone,
        }
    }

    /// The harmonic mean of precision and recall; `None` if nothing changed and nothing was reported.
    pub(super) fn f_score(&self) -> Option<f64> {
        harmonic(self.found, self.false_alarms, self.missed)
    }

    /// The same for "unchanged" (the paper's F-rate with index uc).
    pub(super) fn f_score_unchanged(&self) -> Option<f64> {
        harmonic(self.left_alone, self.missed, self.false_alarms)
    }
}

fn harmonic(hits: usize, wrong: usize, missed: usize) -> Option<f64> {
    let all = 2 * hits + wrong + missed;
    (all > 0).then(|| 2.0 * hits as f64 / all as f64)
}

/// Area under the ROC curve: the chance that a changed place scores above an unchanged one, ties
/// counting half. `None` without both.
pub(super) fn roc_area(changed: &[f64], unchanged: &[f64]) -> Option<f64> {
    if changed.is_empty() || unchanged.is_empty() {
        return None;
    }
    let mut sorted = unchanged.to_vec();
    sorted.sort_by(f64::total_cmp);
    let wins = changed.iter().map(|score| {
        let below = sorted.partition_point(|other| other < score);
        let not_above = sorted.partition_point(|other| other <= score);
        0.5 * (below + not_above) as f64
    });
    Some(wins.sum::<f64>() / (changed.len() as f64 * sorted.len() as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The paper's first row, rebuilt from six changed laps and about fifty unchanged ones.
    #[test]
    fn rates_of_the_paper_s_first_row() {
        let counts = Counts {
            found: 5,
            missed: 1,
            false_alarms: 0,
            left_alone: 50,
        };
        assert_eq!(counts.precision().value(), Some(1.0));
        assert!((counts.recall().value().unwrap() - 0.83).abs() < 0.005);
        assert!((counts.f_score().unwrap() - 0.91).abs() < 0.005);
        assert!((counts.f_score_unchanged().unwrap() - 0.99).abs() < 0.005);
        assert_eq!(Counts::default().f_score(), None);
    }

    #[test]
    fn decisions_are_counted_where_they_belong() {
        let mut counts = Counts::default();
        for (changed, reported) in [(true, true), (true, false), (false, true), (false, false)] {
            counts.add(changed, reported);
        }
        let mut twice = counts;
        twice.merge(&counts);
        assert_eq!(twice.recall(), Share { hits: 2, of: 4 });
        assert_eq!(twice.false_alarm_rate(), Share { hits: 2, of: 4 });
    }

    proptest! {
        #[test]
        fn the_area_is_the_share_of_pairs_in_order(
            changed in prop::collection::vec(0..6_u8, 1..20),
            unchanged in prop::collection::vec(0..6_u8, 1..20),
        ) {
            let mut wins = 0.0;
            for a in &changed {
                for b in &unchanged {
                    wins += if a > b { 1.0 } else if a == b { 0.5 } else { 0.0 };
                }
            }
            let as_scores = |v: &[u8]| v.iter().map(|&s| f64::from(s)).collect::<Vec<_>>();
            let area = roc_area(&as_scores(&changed), &as_scores(&unchanged)).unwrap();
            prop_assert!((area - wins / (changed.len() * unchanged.len()) as f64).abs() < 1e-12);
        }
    }
}
