//! What is known of a vehicle over its trips, and what of it is applied.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::motion_terms::median;
use super::{Combined, Corrections, Estimate, Estimates, Quantity, TripCalibration};

/// So many of the newest trips are kept.
const TRIPS_MAX: usize = 20;
/// A value is applied if it is so many standard errors from 0.
const APPLIED_SIGMAS: f64 = 3.0;
/// A standard deviation from a median of absolute values.
const SIGMA_PER_MEDIAN: f64 = 1.4826;
/// A trip contradicts those before it at so many standard deviations.
const CHANGED_SIGMAS: f64 = 4.0;

/// A vehicle's systematic errors, from trip to trip. It is stored as JSON.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct VehicleCalibration {
    /// The newest trips, oldest first.
    trips: Vec<TripCalibration>,
    /// Since which of them (by place) each quantity is as it is; from the first one where nothing
    /// is said.
    since: BTreeMap<Quantity, usize>,
    applied: Estimates,
    changed: Vec<Change>,
    uncorrectable: Vec<String>,
}

/// A value that was believed until a trip contradicted it: a mount that was knocked, a wheel that
/// was replaced.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// What has changed.
    pub quantity: Quantity,
    /// What the trips before said.
    pub before: Estimate,
    /// What the newest trip says.
    pub now: Estimate,
}

impl VehicleCalibration {
    /// With one trip more.
    pub fn with_trip(&self, trip: TripCalibration) -> Self {
        let mut next = self.clone();
        next.changed.clear();
        next.uncorrectable.clone_from(&trip.faults);
        for (quantity, now) in &trip.estimates {
            let Some(before) = self.combined(*quantity) else {
                continue;
            };
            if before.estimate.distance(now) > CHANGED_SIGMAS * self.scatter(*quantity) {
                next.since.insert(*quantity, next.trips.len());
                next.changed.push(Change {
                    quantity: *quantity,
                    before: before.estimate,
                    now: *now,
                });
            }
        }
        next.trips.push(trip);
        let forgotten = next.trips.len().saturating_sub(TRIPS_MAX);
        next.trips.drain(..forgotten);
        for place in next.since.values_mut() {
            *place = place.saturating_sub(forgotten);
        }
        next.applied = Quantity::ALL
            .into_iter()
            .filter_map(|quantity| Some((quantity, next.to_apply(quantity)?)))
            .collect();
        next
    }

    /// What the trips since its last change say of a quantity; `None` where none says anything.
    pub fn combined(&self, quantity: Quantity) -> Option<Combined> {
        let estimates: Vec<Estimate> = self
            .valid_trips(quantity)
            .filter_map(|trip| trip.estimates.get(&quantity).copied())
            .collect();
        let combined = Combined::of(&estimates)?.floored(quantity);
        Some(combined.scattered(self.scatter(quantity)))
    }

    /// How many times as far as their errors say a quantity's trips are from the trips that follow
    /// them, at least 1: what changes from trip to trip (a load, a tyre, a lidar that tilts) is in
    /// no error of a single trip. The median, since a mount that is knocked once is no scatter; 1
    /// for fewer than three trips.
    fn scatter(&self, quantity: Quantity) -> f64 {
        let estimates = self.trips.iter().filter_map(|t| t.estimates.get(&quantity));
        let estimates: Vec<&Estimate> = estimates.collect();
        let apart: Vec<f64> = estimates
            .windows(2)
            .map(|pair| pair[0].distance(pair[1]))
            .collect();
        match apart.len() {
            0 | 1 => 1.0,
            _ => (SIGMA_PER_MEDIAN * median(apart)).max(1.0),
        }
    }

    fn valid_trips(&self, quantity: Quantity) -> impl Iterator<Item = &TripCalibration> {
        let since = self.since.get(&quantity).copied().unwrap_or(0);
        self.trips.iter().skip(since)
    }

    /// A value that is far from 0, exact enough, and that two trips, or both halves of one, agree
    /// on.
    fn to_apply(&self, quantity: Quantity) -> Option<Estimate> {
        let combined = self.combined(quantity)?;
        let agrees = match combined.count {
            // One that contradicts others has to be confirmed by another one.
            1 if self.since.contains_key(&quantity) => false,
            1 => {
                let mut trips = self.valid_trips(quantity);
                trips.any(|trip| {
                    trip.estimates.contains_key(&quantity) && trip.agrees_with_itself(quantity)
                })
            }
            _ => combined.agrees(),
        };
        let estimate = combined.estimate;
        let applies = agrees
            && estimate.significance() > APPLIED_SIGMAS
            && estimate.sigma <= quantity.applied_sigma_max();
        applies.then_some(estimate)
    }

    /// What is to be corrected.
    pub fn applied(&self) -> &Estimates {
        &self.applied
    }

    /// The same as values to correct by.
    pub fn corrections(&self) -> Corrections {
        Corrections::of(&self.applied)
    }

    /// What the newest trip has contradicted; what was applied of it no longer is.
    pub fn changed(&self) -> &[Change] {
        &self.changed
    }

    /// Faults of the newest trip that no correction mends.
    pub fn uncorrectable(&self) -> &[String] {
        &self.uncorrectable
    }

    /// The newest trips, oldest first.
    pub fn trips(&self) -> &[TripCalibration] {
        &self.trips
    }
}

#[cfg(test)]
mod tests;
