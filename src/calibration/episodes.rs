//! What a vehicle's trips say of one quantity, parted where the vehicle has changed.

use super::{Combined, Estimate, Quantity};

/// One trip's word: its place among the vehicle's trips, and what it says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Word {
    pub trip: usize,
    pub estimate: Estimate,
}

/// The words on one quantity since it was last another one, and those before.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Episodes {
    /// What held before the last change; empty if there was none.
    pub before: Vec<Word>,
    /// What holds now.
    pub now: Vec<Word>,
    /// The newest word, where it contradicts those before it and nothing has confirmed it yet.
    pub odd: Option<Word>,
}

/// So many trips must agree before another one contradicts them.
const TRIPS_BEFORE: usize = 3;
/// A trip's error may be so many times what the trip says: what a day does to a lidar (a load, a
/// tilt) is in no error of a single trip.
const WIDENED: f64 = 3.0;
/// A trip contradicts those before it at so many standard deviations.
const CONTRADICTING_SIGMAS: f64 = 5.0;

impl Episodes {
    /// Of words in the order of time. A word that contradicts those before begins another episode
    /// if the next one agrees with it, and is forgotten otherwise.
    pub fn of(quantity: Quantity, words: impl IntoIterator<Item = Word>) -> Self {
        let mut episodes = Self::default();
        for word in words {
            episodes.take(quantity, word);
        }
        episodes
    }

    fn take(&mut self, quantity: Quantity, word: Word) {
        if let Some(odd) = self.odd.take() {
            let apart = |value: f64| (word.estimate.value - value).abs();
            let is_like_odd = apart(odd.estimate.value) < apart(mean(&self.now));
            if is_like_odd && contradicts(quantity, &self.now, &word) {
                self.before = std::mem::replace(&mut self.now, vec![odd, word]);
                return;
            }
        }
        let is_young = self.now.len() < TRIPS_BEFORE && !self.before.is_empty();
        if is_young && !contradicts(quantity, &self.before, &word) {
            self.now = std::mem::take(&mut self.before);
        }
        match contradicts(quantity, &self.now, &word) {
            true => self.odd = Some(word),
            false => self.now.push(word),
        }
    }
}

/// Whether a trip is farther from those before it than errors allow, and far enough to matter.
fn contradicts(quantity: Quantity, before: &[Word], word: &Word) -> bool {
    if before.len() < TRIPS_BEFORE {
        return false;
    }
    let count = before.len() as f64;
    let Estimate {
        value: mean_value,
        sigma: scatter,
    } = mean_and_deviation(before);
    let said = before.iter().map(|w| w.estimate.sigma).sum::<f64>() / count;
    let sigma = scatter.max(WIDENED * said.max(word.estimate.sigma));
    let allowed = CONTRADICTING_SIGMAS * sigma * (1.0 + 1.0 / count).sqrt();
    (word.estimate.value - mean_value).abs() > allowed.max(quantity.changed_min())
}

fn mean(words: &[Word]) -> f64 {
    words.iter().map(|w| w.estimate.value).sum::<f64>() / words.len().max(1) as f64
}

/// The mean of words and their standard deviation; 0 for fewer than two.
pub(super) fn mean_and_deviation(words: &[Word]) -> Estimate {
    let value = mean(words);
    let squares = words.iter().map(|w| (w.estimate.value - value).powi(2));
    let freedoms = words.len().saturating_sub(1).max(1) as f64;
    Estimate {
        value,
        sigma: (squares.sum::<f64>() / freedoms).sqrt(),
    }
}

/// Words as one value, with an error that is not below what their scatter says, nor below the
/// quantity's floor. `None` without any.
pub(super) fn combined(quantity: Quantity, words: &[Word]) -> Option<Combined> {
    let estimates: Vec<Estimate> = words.iter().map(|word| word.estimate).collect();
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

/// The value that words are sure of: at least [`TRIPS_MIN`] of them, whose mean is farther from 0
/// than is worth a correction, than their errors and, by Student's test, than their scatter say, and
/// the newest confirms what those before it say.
pub(super) fn sure(quantity: Quantity, words: &[Word]) -> Option<Estimate> {
    let (newest, others) = words.split_last()?;
    if words.len() < TRIPS_MIN {
        return None;
    }
    let all = combined(quantity, words)?;
    let of_others = combined(quantity, others)?.estimate.value;
    let student = STUDENT[(words.len() - TRIPS_MIN).min(STUDENT.len() - 1)];
    let Estimate { value, sigma } = all.estimate;
    // What the beams' spacing leaves open is the same in all trips, however many there are.
    let shared = match quantity {
        Quantity::TurnScale => words
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
