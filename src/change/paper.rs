//! The paper's steps 3 and 4: from peaks of the derivative to changes and their places
//! (section 4.2).

use super::series::{ConvergenceRule, ResidualSeries, SeriesEntry, SeriesParams};
use crate::geometry::Vector2;
use crate::ids::EdgeId;
use crate::model::ResidualVerdict;

/// Laps that must be over before anything is judged (section 4.1).
const LAPS_MIN: usize = 2;
/// E + √Var of one term σ²χ²₁, as the paper has it (equations 4 and 5), in units of σ²: what
/// counts as raised beside a peak.
const RAISED_FACTOR: f64 = 1.0 + std::f64::consts::SQRT_2;

/// Where and when a closure was made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosurePlace {
    /// Halfway between its two nodes, map frame, metres.
    pub position: Vector2<f64>,
    /// The lap of its new node, from 0.
    pub lap: usize,
}

/// How peaks become changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PaperParams {
    /// Parameters of the series; its smoothing also determines how far a peak reaches.
    pub series: SeriesParams,
    /// Closures that must be raised at a peak: one alone is a temporary minimum of the
    /// optimisation (step 3).
    pub raised_min: usize,
    /// Peaks this near to each other show the same change, metres.
    pub same_place_m: f64,
}

impl PaperParams {
    /// The printed rule: absolute bound 3·10⁻⁶ on the change of f, nothing before the closures of
    /// two laps, threshold `factor` · σ²(1 + 3√2).
    ///
    /// The paper leaves open how wide a peak is and what "near" means; two closures, and 5 m, the
    /// farthest that the nodes of a closure are apart, are our reading.
    pub fn for_laps(places: &[ClosurePlace], factor: f64) -> Self {
        let early = places.iter().filter(|place| place.lap < LAPS_MIN);
        Self {
            series: SeriesParams {
                convergence: ConvergenceRule::PAPER,
                closures_min: early.count(),
                threshold_factor: factor,
                ..SeriesParams::default()
            },
            raised_min: 2,
            same_place_m: 5.0,
        }
    }
}

/// A peak whose unsmoothed ΔF exceeds the threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// The closure that exceeds it most: the place of the change (section 4.1).
    pub edge_id: EdgeId,
    /// Its number in the series.
    pub n: usize,
    /// Where and when it was made.
    pub place: ClosurePlace,
    /// Its ΔF.
    pub delta_f: f64,
    /// ΔF over the threshold.
    pub ratio: f64,
}

/// A change by the paper's rule.
#[derive(Debug, Clone, PartialEq)]
pub struct PaperChange {
    /// The highest peak of the lap that first shows it.
    pub first: Peak,
    /// Lower peaks near it in later laps, the highest of each lap: the same change again.
    pub repeats: Vec<Peak>,
}

/// The changes that a series shows, in the order in which they were raised. `places` has a place
/// for each entry of the series.
///
/// Within a lap, peaks near each other are one change. In a later lap a peak near a change is
/// that change again if no closure of it was higher, and a new change otherwise (step 3).
pub fn paper_changes(
    series: &ResidualSeries,
    places: &[ClosurePlace],
    params: &PaperParams,
) -> Vec<PaperChange> {
    let mut changes: Vec<PaperChange> = Vec::new();
    for (k, (entry, place)) in series.entries.iter().zip(places).enumerate() {
        let Some(peak) = candidate(series, k, entry, *place, params) else {
            continue;
        };
        let near = |change: &&mut PaperChange| {
            let apart = change.first.place.position - place.position;
            apart.norm() <= params.same_place_m
        };
        // The latest near one is the highest: it was a new maximum.
        match changes.iter_mut().rev().find(near) {
            Some(change) if change.takes(&peak) => change.join(peak),
            _ => changes.push(PaperChange {
                first: peak,
                repeats: Vec::new(),
            }),
        }
    }
    changes
}

fn candidate(
    series: &ResidualSeries,
    k: usize,
    entry: &SeriesEntry,
    place: ClosurePlace,
    params: &PaperParams,
) -> Option<Peak> {
    if !entry.peak || entry.verdict != ResidualVerdict::Contradiction {
        return None;
    }
    let reach = params.series.peak_reach();
    let beside = k.saturating_sub(reach)..(k + reach + 1).min(series.entries.len());
    let bound = RAISED_FACTOR * series.sigma2?;
    let raised = series.entries[beside].iter().filter(|e| e.delta_f > bound);
    (raised.count() >= params.raised_min).then_some(Peak {
        edge_id: entry.edge_id,
        n: entry.n,
        place,
        delta_f: entry.delta_f,
        ratio: entry.ratio?,
    })
}

impl PaperChange {
    fn takes(&self, peak: &Peak) -> bool {
        peak.place.lap == self.first.place.lap || peak.delta_f <= self.first.delta_f
    }

    fn join(&mut self, peak: Peak) {
        let same_lap = |known: &&mut Peak| known.place.lap == peak.place.lap;
        let known = std::iter::once(&mut self.first).chain(&mut self.repeats);
        match known.into_iter().find(same_lap) {
            Some(known) if peak.delta_f > known.delta_f => *known = peak,
            Some(_) => {}
            None => self.repeats.push(peak),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::series::{ClosureSample, residual_series};
    use super::*;

    const LAP: usize = 40;
    const LAPS: usize = 8;
    const BASE: f64 = 1e-4;

    /// Closures a metre apart on a straight, lap after lap, each adding about the same.
    fn world(bumps: &[(usize, usize, &[f64])]) -> (Vec<ClosureSample>, Vec<ClosurePlace>) {
        let mut increases: Vec<f64> = (0..LAPS * LAP)
            .map(|k| BASE * (1.0 + 0.3 * ((k * 7) % 5) as f64 / 5.0))
            .collect();
        for &(lap, at, values) in bumps {
            for (j, value) in values.iter().enumerate() {
                increases[lap * LAP + at + j] += BASE * value;
            }
        }
        let sample = |(k, &delta_f)| ClosureSample {
            edge_id: EdgeId(k as i64),
            delta_f,
        };
        let place = |k: usize| ClosurePlace {
            position: Vector2::new((k % LAP) as f64, 0.0),
            lap: k / LAP,
        };
        (
            increases.iter().enumerate().map(sample).collect(),
            (0..increases.len()).map(place).collect(),
        )
    }

    fn changes(bumps: &[(usize, usize, &[f64])], factor: f64) -> Vec<PaperChange> {
        let (samples, places) = world(bumps);
        let params = PaperParams::for_laps(&places, factor);
        let series = residual_series(&samples, &params.series);
        paper_changes(&series, &places, &params)
    }

    #[test]
    fn nothing_is_judged_before_two_laps_are_over() {
        let (samples, places) = world(&[]);
        let params = PaperParams::for_laps(&places, 1.0);
        assert_eq!(params.series.closures_min, 2 * LAP);
        let series = residual_series(&samples, &params.series);
        assert_eq!(series.converged_at, Some(2 * LAP));
        assert!(changes(&[(1, 20, &[10.0, 30.0, 10.0])], 1.0).is_empty());
        assert!(changes(&[], 1.0).is_empty());
    }

    #[test]
    fn a_step_is_placed_at_the_closure_that_exceeds_most() {
        let found = changes(&[(5, 20, &[3.0, 12.0, 25.0, 9.0])], 1.0);
        assert_eq!(found.len(), 1);
        let first = found[0].first;
        assert_eq!(first.edge_id, EdgeId((5 * LAP + 22) as i64));
        assert_eq!((first.n, first.place.lap), (5 * LAP + 23, 5));
        assert!(first.ratio > 3.0 && found[0].repeats.is_empty());
    }

    #[test]
    fn lower_peaks_once_a_lap_are_the_same_change() {
        let bumps: [(usize, usize, &[f64]); 4] = [
            (3, 20, &[20.0, 40.0, 20.0]),
            (4, 21, &[15.0, 30.0, 15.0]),
            (5, 19, &[10.0, 20.0, 10.0]),
            (6, 20, &[6.0, 12.0, 6.0]),
        ];
        let found = changes(&bumps, 1.0);
        assert_eq!(found.len(), 1);
        let laps: Vec<usize> = found[0].repeats.iter().map(|p| p.place.lap).collect();
        assert_eq!(laps, [4, 5, 6]);
        assert!(
            found[0]
                .repeats
                .iter()
                .all(|p| p.ratio < found[0].first.ratio)
        );
    }

    #[test]
    fn a_higher_maximum_is_a_new_change_and_so_is_another_place() {
        let higher = changes(
            &[(3, 20, &[8.0, 16.0, 8.0]), (5, 20, &[30.0, 60.0, 30.0])],
            1.0,
        );
        assert_eq!(higher.len(), 2);
        let elsewhere = changes(
            &[(3, 8, &[20.0, 40.0, 20.0]), (4, 30, &[8.0, 20.0, 8.0])],
            1.0,
        );
        assert_eq!(elsewhere.len(), 2);
        assert_eq!(elsewhere[1].first.place.lap, 4);
    }

    #[test]
    fn entering_and_leaving_a_changed_place_is_one_change() {
        let found = changes(&[(4, 18, &[8.0, 16.0]), (4, 22, &[12.0, 24.0])], 1.0);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].first.n, 4 * LAP + 24);
    }

    #[test]
    fn a_single_extreme_value_is_no_change() {
        assert!(changes(&[(4, 20, &[40.0])], 1.0).is_empty());
        assert_eq!(changes(&[(4, 20, &[40.0, 4.0])], 1.0).len(), 1);
    }

    #[test]
    fn a_higher_threshold_raises_less() {
        let bumps: [(usize, usize, &[f64]); 1] = [(4, 20, &[6.0, 9.0, 6.0])];
        assert_eq!(changes(&bumps, 1.0).len(), 1);
        assert!(changes(&bumps, 2.5).is_empty());
    }

    #[test]
    fn what_is_found_does_not_depend_on_the_unit_of_length() {
        let bumps: [(usize, usize, &[f64]); 2] =
            [(3, 20, &[20.0, 40.0, 20.0]), (5, 5, &[10.0, 20.0])];
        let (mut samples, places) = world(&bumps);
        let mut params = PaperParams::for_laps(&places, 1.0);
        params.series.convergence = ConvergenceRule::Relative(2e-3);
        let tell = |samples: &[ClosureSample]| {
            let found = paper_changes(&residual_series(samples, &params.series), &places, &params);
            let edges = found.iter().map(|c| c.first.edge_id);
            edges.collect::<Vec<_>>()
        };
        let metres = tell(&samples);
        for sample in &mut samples {
            sample.delta_f *= 1e6;
        }
        assert_eq!(metres, tell(&samples));
        assert_eq!(metres.len(), 2);
    }
}
