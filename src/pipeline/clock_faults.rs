//! Trips of a route whose clock is behind, and what follows for their vehicles.
//!
//! A trip counts from when it arrived if its vehicle's trip before says that the clock is behind
//! (`clock.rs`). The first trip of a vehicle whose clock was always behind cannot know: it is found out
//! while it is driven, by vehicles that are on time. From then on what it observed, before and after,
//! says nothing: it would be judged in the wrong order.

use std::collections::{BTreeMap, BTreeSet};

use crate::calibration::VehicleFault;
use crate::change::{Suspect, Tier};
use crate::ids::{StampNs, TripId, VehicleId};

use crate::store::ClockFault;

const HOUR_NS: f64 = 3.6e12;
/// How many standard errors such a fault is from none: batch after batch says it.
const SIGNIFICANCE: f64 = 5.0;

/// What is known of a route's clocks, by trip.
#[derive(Debug, Clone, Default)]
pub(super) struct ClockFaults(BTreeMap<TripId, ClockFault>);

impl ClockFaults {
    pub fn of(faults: Vec<ClockFault>) -> Self {
        let by_trip = faults.into_iter().map(|fault| (fault.trip.clone(), fault));
        Self(by_trip.collect())
    }

    pub fn has(&self, trip: &TripId) -> bool {
        self.0.contains_key(trip)
    }

    pub fn put(&mut self, fault: ClockFault) {
        self.0.insert(fault.trip.clone(), fault);
    }

    /// Forgets trips that were taken out.
    pub fn forget(&mut self, trips: &[TripId]) {
        self.0.retain(|trip, _| !trips.contains(trip));
    }

    /// From a stamp on the vehicle's clock is right again; returns the faults that end so.
    pub fn end(&mut self, vehicle: &VehicleId, until: StampNs) -> Vec<ClockFault> {
        let standing = self.0.values_mut();
        let standing = standing.filter(|fault| fault.vehicle == *vehicle && fault.until.is_none());
        let ended = standing.map(|fault| {
            fault.until = Some(until);
            fault.clone()
        });
        ended.collect()
    }

    /// Adds the vehicles of these trips to those that are suspected for other reasons.
    pub fn add_to(&self, suspects: &mut Vec<Suspect>) {
        let vehicles: BTreeSet<&VehicleId> = self.0.values().map(|fault| &fault.vehicle).collect();
        for vehicle in vehicles {
            let of_vehicle = self.0.values().filter(|fault| fault.vehicle == *vehicle);
            let Some(clock) = suspect(vehicle, of_vehicle.collect()) else {
                continue;
            };
            match suspects.iter_mut().find(|known| known.vehicle == *vehicle) {
                Some(known) => join(known, clock),
                None => suspects.push(clock),
            }
        }
    }
}

/// What a vehicle's faults make of it: those that stand, or all of them once none does.
fn suspect(vehicle: &VehicleId, mut faults: Vec<&ClockFault>) -> Option<Suspect> {
    let stands = faults.iter().any(|fault| fault.until.is_none());
    faults.retain(|fault| !stands || fault.until.is_none());
    let newest = faults.iter().max_by_key(|fault| fault.last_seen)?;
    let text = format!(
        "the clock is behind by about {:.0} h: batches arrive one by one as they are driven, so much later than \
         they are stamped, while those of other vehicles arrive on time; what the trip observed says nothing about \
         changes",
        newest.behind_ns as f64 / HOUR_NS
    );
    Some(Suspect {
        vehicle: vehicle.clone(),
        faults: vec![VehicleFault::uncorrectable(None, &text)],
        trips: faults.iter().map(|fault| fault.trip.clone()).collect(),
        scans: faults.iter().map(|fault| fault.scans as usize).sum(),
        sound_until: None,
        since: faults.iter().map(|fault| fault.since).min()?,
        last_seen: newest.last_seen,
        until: faults.iter().filter_map(|fault| fault.until).max(),
        tier: Tier::Confirmed,
        significance: SIGNIFICANCE,
    })
}

/// One suspect for two reasons; for the one that stands, if the other has ended.
fn join(known: &mut Suspect, clock: Suspect) {
    match (known.until, clock.until) {
        (Some(_), None) => {
            *known = clock;
            return;
        }
        (None, Some(_)) => return,
        _ => {}
    }
    let trips: BTreeSet<TripId> = known.trips.drain(..).chain(clock.trips).collect();
    known.trips = trips.into_iter().collect();
    known.faults.extend(clock.faults);
    known.scans += clock.scans;
    known.since = known.since.min(clock.since);
    known.last_seen = known.last_seen.max(clock.last_seen);
    known.until = known.until.zip(clock.until).map(|(a, b)| a.max(b));
    known.tier = Tier::Confirmed;
    known.significance = known.significance.max(clock.significance);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(vehicle: &str, trip: &str, at: i64) -> ClockFault {
        ClockFault {
            trip: TripId::new(trip).unwrap(),
            vehicle: VehicleId::new(vehicle).unwrap(),
            behind_ns: 20 * HOUR_NS as i64,
            since: StampNs(at),
            last_seen: StampNs(at + 5),
            scans: 40,
            until: None,
        }
    }

    fn suspects(faults: &ClockFaults) -> Vec<Suspect> {
        let mut suspects = Vec::new();
        faults.add_to(&mut suspects);
        suspects
    }

    #[test]
    fn a_vehicle_is_suspected_until_its_clock_is_right() {
        let (vehicle, mut faults) = (VehicleId::new("v").unwrap(), ClockFaults::default());
        faults.put(fault("v", "first", 10));
        faults.put(fault("w", "other", 30));
        let found = suspects(&faults);
        assert_eq!(found.len(), 2);
        assert!(found[0].faults[0].text.contains("behind by about 20 h"));
        assert_eq!((found[0].until, found[0].since), (None, StampNs(10)));
        let ended = faults.end(&vehicle, StampNs(50));
        assert_eq!(ended[0].until, Some(StampNs(50)));
        assert!(faults.end(&vehicle, StampNs(60)).is_empty(), "it has ended");
        assert_eq!(suspects(&faults)[0].until, Some(StampNs(50)));
        faults.put(fault("v", "later", 70));
        let again = &suspects(&faults)[0];
        assert_eq!((again.until, again.since), (None, StampNs(70)));
        faults.forget(&again.trips);
        assert!(!faults.has(&TripId::new("later").unwrap()));
    }

    #[test]
    fn what_else_is_off_is_said_beside_it() {
        let mut faults = ClockFaults::default();
        faults.put(fault("v", "first", 10));
        let mut known = suspects(&faults);
        known[0].trips = vec![TripId::new("z").unwrap()];
        let mut ended = known.clone();
        faults.add_to(&mut known);
        assert_eq!((known.len(), known[0].faults.len()), (1, 2));
        assert_eq!((known[0].trips.len(), known[0].until), (2, None));
        ended[0].until = Some(StampNs(90));
        faults.add_to(&mut ended);
        assert_eq!((&ended, ended[0].until), (&suspects(&faults), None));
    }
}
