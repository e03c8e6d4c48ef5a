//! What a vehicle's trips say of one quantity, parted where the vehicle has changed.

use super::{Combined, Estimate, Quantity};

/// What one trip shows: its place among the vehicle's trips, and its estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    pub trip: usize,
    pub estimate: Estimate,
}

/// The samples on one quantity since it was last another one, and those before.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Episodes {
    /// What held before the last change; empty if there was none.
    pub before: Vec<Sample>,
    /// What holds now.
    pub now: Vec<Sample>,
    /// The newest sample, where it contradicts those before it and nothing has confirmed it yet.
    pub odd: Option<Sample>,
}

/// So many trips must agree before another one contradicts them.
const TRIPS_BEFORE: usize = 3;
/// A trip's error may be so many times what the trip says: what a day does to a lidar (a load, a
/// tilt) is in no error of a single trip.
const WIDENED: f64 = 3.0;
/// A trip contradicts those before it at so many standard deviations.
const CONTRADICTING_SIGMAS: f64 = 5.0;

impl Episodes {
    /// Of samples in the order of time. A sample that contradicts those before begins another episode
    /// if the next one agrees with it, and is forgotten otherwise.
    pub fn of(quantity: Quantity, samples: impl IntoIterator<Item = Sample>) -> Self {
        let mut episodes = Self::default();
        for sample in samples {
            episodes.take(quantity, sample);
        }
        episodes
    }

    fn take(&mut self, quantity: Quantity, sample: Sample) {
        if let Some(odd) = self.odd.take() {
            let apart = |value: f64| (sample.estimate.value - value).abs();
            let is_like_odd = apart(odd.estimate.value) < apart(mean(&self.now));
            if is_like_odd && contradicts(quantity, &self.now, &sample) {
                self.before = std::mem::replace(&mut self.now, vec![odd, sample]);
                return;
            }
        }
        let is_young = self.now.len() < TRIPS_BEFORE && !self.before.is_empty();
        if is_young && !contradicts(quantity, &self.before, &sample) {
            self.now = std::mem::take(&mut self.before);
        }
        match contradicts(quantity, &self.now, &sample) {
            true => self.odd = Some(sample),
            false => self.now.push(sample),
        }
    }
}

/// Whether a trip is farther from those before it than errors allow, and far enough to matter.
fn contradicts(quantity: Quantity, before: &[Sample], sample: &Sample) -> bool {
    if before.len() < TRIPS_BEFORE {
        return false;
    }
    let count = before.len() as f64;
    let Estimate {
        value: mean_value,
        sigma: scatter,
    } = mean_and_deviation(before);
    let stated = before.iter().map(|w| w.estimate.sigma).sum::<f64>() / count;
    let sigma = scatter.max(WIDENED * stated.max(sample.estimate.sigma));
    let allowed = CONTRADICTING_SIGMAS * sigma * (1.0 + 1.0 / count).sqrt();
    (sample.estimate.value - mean_value).abs() > allowed.max(quantity.changed_min())
}

fn mean(samples: &[Sample]) -> f64 {
    samples.iter().map(|w| w.estimate.value).sum::<f64>() / samples.len().max(1) as f64
}

/// The mean of samples and their standard deviation; 0 for fewer than two.
pub(super) fn mean_and_deviation(samples: &[Sample]) -> Estimate {
    let value = mean(samples);
    let squares = samples.iter().map(|w| (w.estimate.value - value).powi(2));
    let freedoms = samples.len().saturating_sub(1).max(1) as f64;
    Estimate {
        value,
        sigma: (squares.sum::<f64>() / freedoms).sqrt(),
    }
}

/// Samples as one value, with an error that is not below what their scatter says, nor below the
/// quantity's floor. `None` without any.
pub(super) fn combined(quantity: Quantity, samples: &[Sample]) -> Option<Combined> {
    let estimates: Vec<Estimate> = samples.iter().map(|sample| sample.estimate).collect();
    Some(Combined::of(&estimates)?.floored(quantity))
}

/// So many trips are asked before anything is corrected: three that agree, and one that confirms
/// them.
pub(super) const TRIPS_MIN: usize = 4;
/// A value is applied if it is so many standard errors from 0.
const APPLIED_SIGMAS: f64 = 3.0;
/// Quantiles of Student's distribution, two-sided with a probability of 0.001, for 3 degrees of
/// freedom and more; for more than here the last one.
const STUDENT: [f64; 17] = [
    12.92, 8.61, 6.87, 5.96, 5.41, 5.04, 4.78, 4.59, 4.44, 4.32, 4.22, 4.14, 4.07, 4.01, 3.97,
    3.92, 3.88,
];
/// The newest trip says no less and no more than so many times what the others do.
const CONFIRMING: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// The value that samples are sure of: at least [`TRIPS_MIN`] of them, whose mean is farther from 0
/// than is worth a correction, than their errors and, by Student's test, than their scatter say, and
/// the newest confirms what those before it say.
pub(super) fn sure(quantity: Quantity, samples: &[Sample]) -> Option<Estimate> {
    let (newest, others) = samples.split_last()?;
    if samples.len() < TRIPS_MIN {
        return None;
    }
    let all = combined(quantity, samples)?;
    let of_others = combined(quantity, others)?.estimate.value;
    let student = STUDENT[(samples.len() - TRIPS_MIN).min(STUDENT.len() - 1)];
    let Estimate { value, sigma } = all.estimate;
    // What the beams' spacing leaves open is the same in all trips, however many there are.
    let shared = match quantity {
        Quantity::TurnScale => samples
            .iter()
            .map(|w| w.estimate.sigma)
            .fold(f64::MAX, f64::min),
        _ => sigma,
    };
    let least = quantity
        .applied_min()
        .max(APPLIED_SIGMAS * shared)
        .max(student * all.scatter);
    let is_sure = value.abs() >= least
        && sigma <= quantity.applied_sigma_max()
        && CONFIRMING.contains(&(newest.estimate.value / of_others));
    is_sure.then_some(all.estimate)
}

#[cfg(test)]
mod tests;
