//! What is known of a vehicle over its trips, what of it is sure, and what has changed.

use super::episodes::{Episodes, Sample, TRIPS_MIN, combined, mean_and_deviation, sure};
use super::{Combined, Estimate, Estimates, MapFit, Quantity, TripCalibration};
use crate::ids::{StampNs, TripId};

/// So many of the newest trips of a vehicle's lidar are weighed.
pub const TRIPS_MAX: usize = 20;

/// One trip that does not fit the map may have been given a wrong start pose.
const MISFITS_MIN: usize = 2;

/// What one of a vehicle's trips says.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedTrip {
    /// The trip.
    pub trip: TripId,
    /// When the newest scan that it rests on was taken.
    pub stamp: StampNs,
    /// Scans that it rests on.
    pub scans: u32,
    /// The estimates.
    pub calibration: TripCalibration,
}

/// A lidar's and its vehicle's systematic errors, by the newest trips.
///
/// It is a function of the trips' estimates and their order alone, and what trips say is about the
/// vehicle as stated: no correction rests on another one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VehicleCalibration {
    trips: Vec<CalibratedTrip>,
    /// In the order of [`Quantity::ALL`].
    episodes: Vec<Episodes>,
}

/// A value that was believed until trips contradicted it: a mount that was knocked, a wheel that
/// was replaced.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// What has changed.
    pub quantity: Quantity,
    /// What the trips before said.
    pub before: Estimate,
    /// What the trips since say.
    pub now: Estimate,
    /// The places of the trips that say so, among [`VehicleCalibration::trips`].
    pub trips: Vec<usize>,
    /// The last trip before, by its place.
    pub last_before: usize,
    /// Whether a second trip says the same.
    pub is_confirmed: bool,
    /// The trip, by its place, from which on the vehicle is as well known as it was before.
    pub known_anew: Option<usize>,
}

impl VehicleCalibration {
    /// Of the trips of a lidar, the oldest first; the newest of them count.
    pub fn of(mut trips: Vec<CalibratedTrip>) -> Self {
        trips.drain(..trips.len().saturating_sub(TRIPS_MAX));
        let episodes = Quantity::ALL.map(|quantity| {
            let samples = trips.iter().enumerate();
            let samples = samples.filter_map(|(trip, known)| {
                let estimate = *known.calibration.estimates.get(&quantity)?;
                Some(Sample { trip, estimate })
            });
            Episodes::of(quantity, samples)
        });
        Self {
            trips,
            episodes: episodes.into(),
        }
    }

    /// What the trips since its last change say of a quantity; `None` where none says anything.
    pub fn combined(&self, quantity: Quantity) -> Option<Combined> {
        combined(quantity, &self.episodes_of(quantity)?.now)
    }

    /// What is to be corrected: nothing that the newest trip contradicts.
    pub fn sure(&self) -> Estimates {
        self.sure_where(Quantity::is_corrected)
    }

    /// What is sure and not corrected.
    pub fn uncorrected(&self) -> Estimates {
        self.sure_where(|quantity| quantity.is_of_vehicle() && !quantity.is_corrected())
    }

    fn sure_where(&self, is_meant: impl Fn(Quantity) -> bool) -> Estimates {
        let known = Quantity::ALL.into_iter().zip(&self.episodes);
        let known = known.filter(|(quantity, of)| is_meant(*quantity) && of.odd.is_none());
        known
            .filter_map(|(quantity, of)| Some((quantity, sure(quantity, &of.now)?)))
            .collect()
    }

    /// What has changed within the trips that are weighed, the last time for each quantity.
    pub fn changes(&self) -> Vec<Change> {
        let known = Quantity::ALL.into_iter().zip(&self.episodes);
        let known = known.filter(|(quantity, _)| quantity.is_of_vehicle());
        known
            .filter_map(|(quantity, of)| change(quantity, of))
            .collect()
    }

    /// The quantities that are far off in most trips and not sure enough to be corrected, since they
    /// differ from trip to trip: what trips say on average, and the standard deviation among them.
    pub fn unsteady(&self) -> Vec<(Quantity, Estimate)> {
        let (sure, uncorrected) = (self.sure(), self.uncorrected());
        let known = Quantity::ALL.into_iter().zip(&self.episodes);
        let known = known.filter(|(quantity, _)| quantity.is_of_vehicle());
        let is_unsteady = |(quantity, of): &(Quantity, &Episodes)| {
            let far = of.now.iter();
            let far = far.filter(|sample| sample.estimate.value.abs() >= quantity.far_min());
            of.now.len() >= TRIPS_MIN
                && 2 * far.count() > of.now.len()
                && of.odd.is_none()
                && !sure.contains_key(quantity)
                && !uncorrected.contains_key(quantity)
        };
        known
            .filter(is_unsteady)
            .map(|(quantity, of)| (quantity, mean_and_deviation(&of.now)))
            .collect()
    }

    /// Faults that no correction mends, those of the newest trip, where each of the newest trips has
    /// some, and the first of these trips, by its place; nothing for too few of them.
    pub fn lasting_faults(&self) -> (usize, &[String]) {
        let is_sound = |trip: &CalibratedTrip| trip.calibration.faults.is_empty();
        let first = self.trips.iter().rposition(is_sound).map_or(0, |k| k + 1);
        match self.trips.len() - first >= TRIPS_MIN {
            true => (first, self.newest_faults()),
            false => (first, &[]),
        }
    }

    /// The first of the newest trips that all fail to fit other vehicles' map, by its place, and how the
    /// newest fits; `None` if only one fails, or none.
    pub fn misfit(&self) -> Option<(usize, MapFit)> {
        let fails = |trip: &CalibratedTrip| trip.calibration.map_fit.is_some_and(|fit| fit.fails());
        let fitting = self.trips.iter().rposition(|trip| !fails(trip));
        let first = fitting.map_or(0, |k| k + 1);
        let newest = self.trips.last()?.calibration.map_fit?;
        (self.trips.len() - first >= MISFITS_MIN).then_some((first, newest))
    }

    /// Faults of the newest trip that no correction mends.
    pub fn newest_faults(&self) -> &[String] {
        let newest = self.trips.last();
        newest.map_or(&[], |trip| trip.calibration.faults.as_slice())
    }

    /// The trips that are weighed, the oldest first.
    pub fn trips(&self) -> &[CalibratedTrip] {
        &self.trips
    }

    fn episodes_of(&self, quantity: Quantity) -> Option<&Episodes> {
        self.episodes.get(quantity as usize)
    }
}

fn change(quantity: Quantity, of: &Episodes) -> Option<Change> {
    let (before, now) = match &of.odd {
        Some(odd) => (&of.now, std::slice::from_ref(odd)),
        None => (&of.before, of.now.as_slice()),
    };
    Some(Change {
        quantity,
        last_before: before.last()?.trip,
        before: combined(quantity, before)?.estimate,
        now: combined(quantity, now)?.estimate,
        trips: now.iter().map(|sample| sample.trip).collect(),
        is_confirmed: now.len() > 1,
        known_anew: now.get(TRIPS_MIN - 1).map(|sample| sample.trip),
    })
}

#[cfg(test)]
mod tests;
