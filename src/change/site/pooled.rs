//! The pooled history of a cluster, over all its cells and observations.

use std::collections::BTreeMap;

use super::answers::Answers;
use super::cluster::Cluster;
use super::timeline::Timeline;
use crate::change::false_alerts::support_for_rate;
use crate::change::history::State;
use crate::change::pass::Standpoint;

/// Weight of an observation that only hits, or only misses, the cluster's cells, in nats.
const NATS_PER_OBSERVATION: f64 = 2.0;
/// Largest weight of a pass, in nats: one pass against one outweighs the cost of a change.
pub const NATS_PER_PASS: f64 = 12.0;
/// An observation of fewer cells weighs less.
const CELLS_FOR_FULL_WEIGHT: f64 = 2.0;
/// How much the share of hits must differ between the two states.
const CONTRAST_MIN: f64 = 0.75;
/// A cell with less contrast has not changed with its cluster.
pub const CELL_CONTRAST_MIN: f64 = 0.5;
/// Least contrast of a cluster that may become clear without misplaced observations.
const PROMISING_CONTRAST_MIN: f64 = 0.55;
/// How much better the change must explain the passes, in nats, where [`FALSE_ALERTS_PER_LAP`] is allowed:
/// that value was found on recordings.
const SUPPORT_MIN: f64 = 4.5;
/// Least support of a change, however many false alerts are allowed, in nats.
const SUPPORT_LEAST: f64 = 1.0;
/// Fewest cells of a change; …
const CELLS_MIN: usize = 8;
/// … a smaller one needs this many, …
const SMALL_CELLS_MIN: usize = 4;
/// … this contrast …
const SMALL_CONTRAST_MIN: f64 = 0.9;
/// … and this support.
const SMALL_SUPPORT_MIN: f64 = 8.0;
/// With this support the surroundings are not checked, in nats.
const SUPPORT_SURE: f64 = 20.0;

/// Least support of a change, in nats, for an allowed rate of false alerts per lap: a tenth of the rate
/// requires ten times the odds.
pub fn support_min(false_alerts_per_lap: f64) -> f64 {
    (SUPPORT_MIN + support_for_rate(false_alerts_per_lap)).max(SUPPORT_LEAST)
}

/// Evidence of an observation by how many cells it hits and misses (at least one), in nats for occupied over
/// free.
pub fn nats_of(hits: f64, misses: f64) -> f64 {
    let cells = hits + misses;
    let weight = (cells / CELLS_FOR_FULL_WEIGHT).min(1.0);
    weight * NATS_PER_OBSERVATION * (hits - misses) / cells
}

/// Clusters with their pooled histories. Cells whose own history differs from their cluster's become clusters
/// of their own.
pub fn separated(answers: &Answers, clusters: Vec<Cluster>) -> Vec<(Cluster, Pooled)> {
    let mut separated = Vec::new();
    let mut left: Vec<Cluster> = clusters.into_iter().rev().collect();
    while let Some(cluster) = left.pop() {
        let Some(pooled) = Pooled::of(answers, &cluster) else {
            continue;
        };
        let (own, other) = pooled.split(answers, cluster);
        if other.cells.is_empty() {
            separated.push((own, pooled));
        } else if !own.cells.is_empty() {
            let parts = [other, own].into_iter();
            left.extend(parts.filter(|part| part.cells.len() >= SMALL_CELLS_MIN));
        }
    }
    separated
}

/// One observation of a cluster.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Index among the site's observations.
    pub observation: usize,
    hits: f64,
    misses: f64,
    /// Whether its pass shows the change.
    pub in_change: bool,
    /// Whether its pass is later than the change.
    pub after_change: bool,
    /// Whether its pass shows an earlier episode of the same change.
    in_earlier_change: bool,
}

impl View {
    /// Whether it shows the cluster in a state.
    pub fn shows(&self, state: State) -> bool {
        match state {
            State::Occupied => self.hits > self.misses,
            State::Free => self.misses > self.hits,
        }
    }
}

/// A cluster's history.
pub struct Pooled {
    /// In the order of trip and time.
    pub views: Vec<View>,
    /// The state in which it was first seen.
    pub baseline: State,
    /// How much better a change explains the passes than no change, in nats.
    pub support: f64,
    /// Passes that show the other state, …
    pub passes_in_change: usize,
    /// … and those that do not.
    pub passes_outside: usize,
    /// Whether the last pass shows the other state.
    pub stands: bool,
    contrast: f64,
}

impl Pooled {
    /// Pools a cluster; `None` if it shows no change as a whole, or another one than its cells.
    pub fn of(answers: &Answers, cluster: &Cluster) -> Option<Self> {
        let mut counts: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
        for answer in cluster.cells.iter().flat_map(|&cell| answers.about(cell)) {
            let (hit, miss) = answers.counts(answer);
            let (hits, misses) = counts.entry(answer.observation).or_default();
            *hits += hit;
            *misses += miss;
        }
        counts.retain(|_, (hits, misses)| *hits + *misses > 0.0);
        let observations: Vec<u32> = counts.keys().copied().collect();
        let standpoints = observations
            .iter()
            .map(|&k| answers.standpoints[k as usize]);
        let standpoints: Vec<Standpoint> = standpoints.collect();
        let nats = counts.values();
        let nats: Vec<f64> = nats.map(|(hits, misses)| nats_of(*hits, *misses)).collect();
        let Timeline { passes, history } = Timeline::of(&standpoints, &nats, NATS_PER_PASS);
        let change = history.last_change()?;
        let baseline = history.baseline().filter(|b| *b == cluster.baseline)?;
        let mut views = Vec::with_capacity(observations.len());
        for (number, pass) in passes.iter().enumerate() {
            for &k in &observations[pass.clone()] {
                let (hits, misses) = counts[&k];
                views.push(View {
                    observation: k as usize,
                    hits,
                    misses,
                    in_change: change.contains(&number),
                    after_change: number >= change.end,
                    in_earlier_change: number < change.start && history.states[number] != baseline,
                });
            }
        }
        // An earlier episode of the new state does not count as the old one.
        let share_of_hits = |counts: &dyn Fn(&View) -> bool| {
            let of_side = views.iter().filter(|view| counts(view));
            let (hits, all) = of_side.fold((0.0, 0.0), |(hits, all), view| {
                (hits + view.hits, all + view.hits + view.misses)
            });
            hits / f64::max(all, f64::MIN_POSITIVE)
        };
        let new = share_of_hits(&|view| view.in_change);
        let old = share_of_hits(&|view| !view.in_change && !view.in_earlier_change);
        let contrast = (new - old).abs();
        views.sort_by_key(|view| view.observation);
        Some(Self {
            views,
            baseline,
            support: history.support,
            passes_in_change: change.len(),
            passes_outside: passes.len() - change.len(),
            stands: change.end == passes.len(),
            contrast,
        })
    }

    /// Splits off the cells whose own history differs: two objects side by side may be one cluster.
    pub fn split(&self, answers: &Answers, cluster: Cluster) -> (Cluster, Cluster) {
        let new_of = |k: u32| {
            let at = self
                .views
                .binary_search_by_key(&(k as usize), |v| v.observation);
            at.is_ok_and(|at| self.views[at].in_change)
        };
        let shares = |cell: &usize| {
            let mut counts = [(0.0, 0.0); 2];
            for answer in answers.about(*cell) {
                let (hit, miss) = answers.counts(answer);
                let (hits, all) = &mut counts[usize::from(new_of(answer.observation))];
                *hits += hit;
                *all += hit + miss;
            }
            let [old, new] = counts.map(|(hits, all)| hits / f64::max(all, f64::MIN_POSITIVE));
            let towards = match self.baseline {
                State::Free => new - old,
                State::Occupied => old - new,
            };
            towards >= CELL_CONTRAST_MIN
        };
        let baseline = cluster.baseline;
        let (own, other) = cluster.cells.into_iter().partition(shares);
        let of_cells = |cells| Cluster { baseline, cells };
        (of_cells(own), of_cells(other))
    }

    /// Whether it may be clear once misplaced observations are dropped.
    pub fn is_promising(&self, cluster: &Cluster) -> bool {
        cluster.cells.len() >= SMALL_CELLS_MIN && self.contrast >= PROMISING_CONTRAST_MIN
    }

    /// Whether a change of this size is clear enough, before its surroundings are checked.
    pub fn is_clear(&self, cluster: &Cluster, support_min: f64) -> bool {
        let cells = cluster.cells.len();
        let is_large = cells >= CELLS_MIN;
        let is_small_but_sure = cells >= SMALL_CELLS_MIN
            && self.contrast >= SMALL_CONTRAST_MIN
            && self.support >= SMALL_SUPPORT_MIN;
        self.contrast >= CONTRAST_MIN
            && self.support >= support_min
            && (is_large || is_small_but_sure)
    }

    /// Whether so many passes show it that no error of the map explains it.
    pub fn is_sure(&self) -> bool {
        self.support >= SUPPORT_SURE
    }

    /// The observations that saw the old state (`false`) or the new one (`true`).
    pub fn side(&self, new: bool) -> impl Iterator<Item = usize> + '_ {
        let of_side = self.views.iter().filter(move |view| view.in_change == new);
        of_side.map(|view| view.observation)
    }
}
