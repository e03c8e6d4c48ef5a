//! The paper's residual series of one sub-graph (sections 4.1 and 4.2).
//!
//! n counts loop closures only. F(n) is the cost at the optimum after the n-th closure,
//! f(n) = F(n)/n. Once f has converged, σ² = f(n*) and the threshold on ΔF are fixed (S8, S9);
//! from then on a closure contradicts the map if its unsmoothed ΔF exceeds the threshold near a
//! peak of d/dn \[G∗F\] (S10, S11).
//!
//! The same series serves closures that were optimised and measurements that were only compared with the
//! optimum: both are streams of non-negative increases of F.

use super::median::RunningMedian;
use super::threshold::{CHI_SQUARED_3_MEDIAN, chi_squared_survival, paper_threshold};
use crate::ids::EdgeId;
use crate::model::ResidualVerdict;

/// The kernel reaches this many of its standard deviations to either side.
const KERNEL_REACH_SIGMAS: f64 = 3.0;
/// A raw ΔF belongs to a smoothed peak this many standard deviations of the kernel away.
const PEAK_REACH_SIGMAS: f64 = 2.0;
/// The least scale of ΔF that thresholds and p-values are built on: below it there is only
/// rounding.
const SCALE_MIN: f64 = 1e-12;
/// ΔF below minus this part of F (and [`SCALE_MIN`]) is no rounding.
const NEGATIVE_TOLERANCE: f64 = 1e-6;

/// One closure of a sub-graph, in the order of insertion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosureSample {
    /// The closure.
    pub edge_id: EdgeId,
    /// ΔF_n = F(n) − F(n−1), both at the optimum; or the increase that a measurement would cause which is
    /// compared but not optimised.
    pub delta_f: f64,
}

/// When f(n) counts as converged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ConvergenceRule {
    /// |Δ(G∗f)| / (G∗f) stays below this: free of units.
    Relative(f64),
    /// |Δ(G∗f)| stays below this, in the unit of F; the paper has 3·10⁻⁶ for metres, radians and
    /// Ω = I (section 4.1).
    Absolute(f64),
}

impl ConvergenceRule {
    /// The paper's bound.
    pub const PAPER: Self = Self::Absolute(3e-6);
}

/// How a series is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeriesParams {
    /// Standard deviation of the Gaussian G, in closures; 0 for no smoothing.
    pub smoothing_sigma: f64,
    /// When f counts as converged.
    pub convergence: ConvergenceRule,
    /// For how many closures in a row: one zero crossing is not convergence.
    pub convergence_hold: usize,
    /// Nothing is judged before this many closures; at least two laps' (section 4.1).
    pub closures_min: usize,
    /// Multiplies the paper's threshold; table 1 has 1 and 2.5.
    pub threshold_factor: f64,
}

impl Default for SeriesParams {
    fn default() -> Self {
        Self {
            smoothing_sigma: 2.0,
            convergence: ConvergenceRule::Relative(2e-3),
            convergence_hold: 5,
            closures_min: 20,
            threshold_factor: 1.0,
        }
    }
}

impl SeriesParams {
    /// A raw ΔF belongs to a smoothed peak at most this many closures away.
    pub(super) fn peak_reach(&self) -> usize {
        (PEAK_REACH_SIGMAS * self.smoothing_sigma.max(0.0)).round() as usize
    }
}

/// A closure's place in the series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeriesEntry {
    /// 1, 2, …
    pub n: usize,
    /// The closure.
    pub edge_id: EdgeId,
    /// F(n), as the sum of the ΔF so far; negative ones count as 0.
    pub total: f64,
    /// f(n) = F(n)/n.
    pub mean: f64,
    /// d/dn \[G∗f\] at n; 0 for the first.
    pub mean_change: f64,
    /// ΔF_n as given, negative or not.
    pub delta_f: f64,
    /// d/dn \[G∗F\] at n.
    pub smoothed: f64,
    /// The threshold on ΔF; `None` while warming up.
    pub threshold: Option<f64>,
    /// ΔF over the threshold; `None` while warming up.
    pub ratio: Option<f64>,
    /// The probability of a ΔF this large without a change, if ΔF is a scaled χ²₃: the scale is
    /// the median of ΔF_1 … ΔF_n over the median of χ²₃, so that even a change of nearly half of the
    /// closures does not hide itself.
    pub p_value: f64,
    /// Whether it is the largest ΔF within two standard deviations of a peak of `smoothed`: the
    /// candidate for the place of a change (S10, S12).
    pub peak: bool,
    /// The verdict of the rule.
    pub verdict: ResidualVerdict,
    /// Whether ΔF is clearly negative. Adding a closure cannot lower the optimum, so the
    /// optimiser had not converged: an error of the solver, not a sign of a change.
    pub negative: bool,
}

/// The series of a sub-graph.
#[derive(Debug, Clone, PartialEq)]
pub struct ResidualSeries {
    /// One entry a closure, in order.
    pub entries: Vec<SeriesEntry>,
    /// n*, once f has converged. It never changes as the series grows.
    pub converged_at: Option<usize>,
    /// σ² = f(n*).
    pub sigma2: Option<f64>,
    /// The threshold on ΔF.
    pub threshold: Option<f64>,
    /// G is centred: `smoothed`, `peak` and a verdict may change until this many further closures have come.
    pub delay: usize,
}

/// Computes the paper's series of a sub-graph's closures in O(n log n). A ΔF that is not a number
/// counts as 0.
pub fn residual_series(samples: &[ClosureSample], params: &SeriesParams) -> ResidualSeries {
    let kernel = Kernel::new(params.smoothing_sigma);
    let increases: Vec<f64> = samples.iter().map(|s| s.delta_f.max(0.0)).collect();
    let (totals, means) = totals_and_means(&increases);
    // Smoothing and differencing commute, except at the borders, where the kernel is cut off and
    // renormalised: smoothing ΔF keeps a constant slope there, smoothing F would not.
    let smoothed = kernel.smooth(&increases);
    let smoothed_means = kernel.smooth(&means);
    let converged_at = converged_at(&smoothed_means, kernel.reach(), params);
    let sigma2 = converged_at.map(|n| means[n - 1]);
    let threshold_of = |sigma2| params.threshold_factor * paper_threshold(sigma2);
    // If all closures agreed exactly, rounding must not count as a change.
    let threshold = sigma2.map(|sigma2| threshold_of(sigma2).max(SCALE_MIN));
    let near_peak = NearPeak::of(&smoothed, &increases, params.peak_reach());
    let p_values = p_values(&increases);

    let entry = |(k, sample): (usize, &ClosureSample)| {
        let judged = threshold.filter(|_| converged_at.is_some_and(|converged| k >= converged));
        let verdict = match judged {
            None => ResidualVerdict::WarmingUp,
            Some(th) if increases[k] > th && near_peak.within[k] => ResidualVerdict::Contradiction,
            Some(_) => ResidualVerdict::Consistent,
        };
        SeriesEntry {
            n: k + 1,
            edge_id: sample.edge_id,
            total: totals[k],
            mean: means[k],
            mean_change: k
                .checked_sub(1)
                .map_or(0.0, |before| smoothed_means[k] - smoothed_means[before]),
            delta_f: sample.delta_f,
            smoothed: smoothed[k],
            threshold: judged,
            ratio: judged.map(|th| increases[k] / th),
            p_value: p_values[k],
            peak: near_peak.largest[k],
            verdict,
            negative: sample.delta_f < -(NEGATIVE_TOLERANCE * totals[k]).max(SCALE_MIN),
        }
    };
    ResidualSeries {
        entries: samples.iter().enumerate().map(entry).collect(),
        converged_at,
        sigma2,
        threshold,
        delay: kernel.reach(),
    }
}

fn totals_and_means(increases: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let mut total = 0.0;
    let sums = increases.iter().enumerate().map(|(k, increase)| {
        total += increase;
        (total, total / (k + 1) as f64)
    });
    sums.unzip()
}

/// The first n at which the rule has held for long enough. Only means with the whole kernel on both sides
/// are considered: they do not change any more.
fn converged_at(smoothed: &[f64], reach: usize, params: &SeriesParams) -> Option<usize> {
    let final_until = smoothed.len().saturating_sub(reach);
    let mut held = 0;
    for k in 1..final_until {
        let change = (smoothed[k] - smoothed[k - 1]).abs();
        let small = match params.convergence {
            ConvergenceRule::Relative(bound) => change <= bound * smoothed[k],
            ConvergenceRule::Absolute(bound) => change < bound,
        };
        held = if small { held + 1 } else { 0 };
        if held >= params.convergence_hold.max(1) && k + 1 >= params.closures_min {
            return Some(k + 1);
        }
    }
    None
}

fn p_values(increases: &[f64]) -> Vec<f64> {
    let mut median = RunningMedian::default();
    let p_value = |&increase: &f64| {
        median.insert(increase);
        let scale = (median.get() / CHI_SQUARED_3_MEDIAN).max(SCALE_MIN);
        chi_squared_survival(increase / scale, 3)
    };
    increases.iter().map(p_value).collect()
}

/// Half of a Gaussian: its weights at distances 0, 1, … closures.
struct Kernel(Vec<f64>);

impl Kernel {
    fn new(sigma: f64) -> Self {
        let reach = (KERNEL_REACH_SIGMAS * sigma.max(0.0)).ceil() as usize;
        let weight = |d: usize| {
            if d == 0 {
                return 1.0;
            }
            let z = d as f64 / sigma;
            (-0.5 * z * z).exp()
        };
        Self((0..=reach).map(weight).collect())
    }

    fn reach(&self) -> usize {
        self.0.len() - 1
    }

    /// The weighted mean around each value; at the borders over the part of the kernel that has values.
    fn smooth(&self, values: &[f64]) -> Vec<f64> {
        let around = |k: usize| {
            let first = k.saturating_sub(self.reach());
            let last = (k + self.reach()).min(values.len() - 1);
            let (mut sum, mut weights) = (0.0, 0.0);
            for (j, value) in values.iter().enumerate().take(last + 1).skip(first) {
                let weight = self.0[j.abs_diff(k)];
                sum += weight * value;
                weights += weight;
            }
            sum / weights
        };
        (0..values.len()).map(around).collect()
    }
}

/// Which closures lie near a peak of the smoothed derivative, and which of them are largest.
struct NearPeak {
    within: Vec<bool>,
    largest: Vec<bool>,
}

impl NearPeak {
    fn of(smoothed: &[f64], increases: &[f64], reach: usize) -> Self {
        let mut near = Self {
            within: vec![false; increases.len()],
            largest: vec![false; increases.len()],
        };
        for k in 0..increases.len() {
            let rises = k == 0 || smoothed[k] > smoothed[k - 1];
            // The last value counts as a peak if it rises, so that a change is detected at once.
            let falls = smoothed.get(k + 1).is_none_or(|next| smoothed[k] >= *next);
            if !(rises && falls) {
                continue;
            }
            let window = k.saturating_sub(reach)..(k + reach + 1).min(increases.len());
            let mut largest = k;
            for j in window {
                near.within[j] = true;
                if increases[j] > increases[largest] {
                    largest = j;
                }
            }
            near.largest[largest] = true;
        }
        near
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::chi_squared;
    use super::*;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn samples(increases: &[f64]) -> Vec<ClosureSample> {
        let sample = |(k, &delta_f)| ClosureSample {
            edge_id: EdgeId(500 + k as i64),
            delta_f,
        };
        increases.iter().enumerate().map(sample).collect()
    }

    fn unchanged(seed: u64, count: usize, degrees: usize) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count)
            .map(|_| 1e-4 * chi_squared(&mut rng, degrees))
            .collect()
    }

    #[test]
    fn nothing_and_one() {
        let none = residual_series(&[], &SeriesParams::default());
        assert!(none.entries.is_empty() && none.converged_at.is_none());
        let one = residual_series(&samples(&[0.25]), &SeriesParams::default());
        let entry = one.entries[0];
        assert_eq!(
            (entry.n, entry.total, entry.mean, entry.smoothed),
            (1, 0.25, 0.25, 0.25)
        );
        assert_eq!(
            (entry.threshold, entry.verdict),
            (None, ResidualVerdict::WarmingUp)
        );
        assert!((entry.p_value - 0.5).abs() < 1e-12);
    }

    /// Scalar errors cross th with probability 2.2 %, three equal components with 0.13 %.
    #[test]
    fn an_unchanged_world_settles_and_is_left_alone_at_the_stated_rate() {
        for (degrees, rate) in [(1, 0.022), (3, 0.0013)] {
            let (mut judged, mut contradictions) = (0, 0);
            for seed in 0..20 {
                let series = residual_series(
                    &samples(&unchanged(seed, 1500, degrees)),
                    &SeriesParams::default(),
                );
                let settled = series.converged_at.unwrap();
                assert!((20..700).contains(&settled), "{settled}");
                let sigma2 = series.sigma2.unwrap();
                assert!(
                    (sigma2 / (1e-4 * degrees as f64) - 1.0).abs() < 0.4,
                    "{sigma2}"
                );
                judged += 1500 - settled;
                let found = series
                    .entries
                    .iter()
                    .filter(|e| e.verdict == ResidualVerdict::Contradiction);
                contradictions += found.count();
            }
            let seen = contradictions as f64 / judged as f64;
            assert!(seen < 1.4 * rate && seen > 0.5 * rate, "{degrees}: {seen}");
        }
    }

    #[test]
    fn a_change_is_found_at_its_place_and_not_before() {
        let mut increases = unchanged(5, 400, 3);
        for (k, step) in [
            (299, 0.001),
            (300, 0.006),
            (301, 0.012),
            (302, 0.007),
            (303, 0.001),
        ] {
            increases[k] += step;
        }
        let series = residual_series(&samples(&increases), &SeriesParams::default());
        let largest = series
            .entries
            .iter()
            .max_by(|a, b| a.smoothed.total_cmp(&b.smoothed))
            .unwrap();
        assert_eq!(largest.n, 302);
        let at = &series.entries[301];
        assert!(
            at.peak && at.verdict == ResidualVerdict::Contradiction && at.edge_id == EdgeId(801)
        );
        assert!(at.ratio.unwrap() > 5.0 && at.p_value < 1e-20);
        let early = series.entries[..298].iter();
        assert!(
            early
                .filter(|e| e.verdict == ResidualVerdict::Contradiction)
                .count()
                <= 2
        );
    }

    /// A change does not raise its own threshold, nor its own p-value's scale.
    #[test]
    fn a_lasting_change_stays_visible() {
        let mut increases = unchanged(9, 600, 3);
        for increases in &mut increases[350..] {
            *increases += 0.01;
        }
        let series = residual_series(&samples(&increases), &SeriesParams::default());
        let later = &series.entries[350..];
        let found = later
            .iter()
            .filter(|e| e.verdict == ResidualVerdict::Contradiction)
            .count();
        assert!(found > 100, "{found}");
        assert!(later.iter().all(|e| e.p_value < 1e-6));
    }

    #[test]
    fn a_clearly_negative_increase_is_flagged_and_never_data() {
        let mut increases = unchanged(1, 100, 3);
        increases[50] = -0.02;
        increases[60] = -1e-18;
        increases[70] = f64::NAN;
        let series = residual_series(&samples(&increases), &SeriesParams::default());
        let flagged: Vec<usize> = series
            .entries
            .iter()
            .filter(|e| e.negative)
            .map(|e| e.n)
            .collect();
        assert_eq!(flagged, [51]);
        assert_eq!(series.entries[50].total, series.entries[49].total);
        assert_eq!(series.entries[50].delta_f, -0.02);
        assert!(
            series
                .entries
                .iter()
                .all(|e| e.total.is_finite() && e.p_value.is_finite())
        );
    }

    #[test]
    fn the_paper_s_rule_waits_for_its_absolute_bound() {
        let params = SeriesParams {
            convergence: ConvergenceRule::PAPER,
            ..SeriesParams::default()
        };
        let metres = residual_series(&samples(&unchanged(2, 500, 3)), &params);
        let settled = metres.converged_at.unwrap();
        // The same world in millimetres: the bound has the unit of F, and is hardly ever met.
        let scaled: Vec<f64> = unchanged(2, 500, 3).iter().map(|g| g * 1e6).collect();
        let millimetres = residual_series(&samples(&scaled), &params);
        assert!(millimetres.converged_at.is_none() && settled < 200);
        let relative = SeriesParams::default();
        let (a, b) = (
            residual_series(&samples(&unchanged(2, 500, 3)), &relative),
            residual_series(&samples(&scaled), &relative),
        );
        assert_eq!(a.converged_at, b.converged_at);
    }

    #[test]
    fn smoothing_keeps_a_constant_slope_up_to_the_borders() {
        let series = residual_series(&samples(&[2.0; 40]), &SeriesParams::default());
        assert!(
            series
                .entries
                .iter()
                .all(|e| (e.smoothed - 2.0).abs() < 1e-12)
        );
        assert_eq!(series.delay, 6);
    }

    proptest! {
        /// What has been said about the past is not taken back, but for the stated delay.
        #[test]
        fn a_longer_series_agrees_about_the_past(seed in 0..1000_u64, cut in 1..300_usize) {
            let increases = unchanged(seed, 300, 3);
            let params = SeriesParams { convergence: ConvergenceRule::Relative(1e-2), ..SeriesParams::default() };
            let whole = residual_series(&samples(&increases), &params);
            let part = residual_series(&samples(&increases[..cut]), &params);
            if part.converged_at.is_some() {
                prop_assert_eq!(part.converged_at, whole.converged_at);
            }
            for (a, b) in part.entries.iter().zip(&whole.entries) {
                prop_assert_eq!((a.total, a.mean, a.p_value), (b.total, b.mean, b.p_value));
                if a.n + part.delay <= cut {
                    prop_assert_eq!(a.smoothed, b.smoothed);
                }
            }
        }
    }
}
