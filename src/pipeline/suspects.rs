//! Which vehicles of a route are suspected, by the calibrations of their trips.

use std::collections::BTreeSet;

use super::vehicles::Calibrations;
use crate::calibration::{Change, Quantity, VehicleCalibration, VehicleFault};
use crate::change::{Suspect, Tier};
use crate::ids::{LidarId, StampNs, TripId, VehicleId};

/// Significance of a fault that was there from the first trip on, in standard errors.
const LASTING_SIGNIFICANCE: f64 = 5.0;

/// A fault with its evidence.
struct Shown {
    fault: VehicleFault,
    /// The trips that show it, by lidar: name, newest scan, scans.
    trips: Vec<(TripId, StampNs, usize)>,
    sound_until: Option<StampNs>,
    until: Option<StampNs>,
    is_confirmed: bool,
    significance: f64,
}

/// The vehicles whose mount, wheels or beams have changed within the trips that are weighed, are far
/// off and another way in each trip, or show what no correction mends. One that is off, always alike,
/// is corrected, and not among them. Where several vehicles find the map too large or too small by
/// about as much, its makers' ranges are off, and none of them is suspected for it.
pub(super) fn suspects(calibrations: &Calibrations) -> Vec<Suspect> {
    let vehicles = calibrations.vehicles();
    vehicles
        .filter_map(|vehicle| suspect(calibrations, vehicle))
        .collect()
}

fn suspect(calibrations: &Calibrations, vehicle: &VehicleId) -> Option<Suspect> {
    let lidars = calibrations.lidars_of(vehicle).enumerate();
    let shown = lidars.flat_map(|(place, (lidar, trips))| {
        let calibration = VehicleCalibration::of(trips.to_vec());
        let mut shown = shown_by(lidar, &calibration);
        shown.extend(misfit(calibrations, vehicle, lidar, &calibration));
        if is_of_map(calibrations, vehicle, &calibration) {
            shown.retain(|shown| shown.fault.quantity != Some(Quantity::RangeScale));
        }
        // Errors of the wheels do not depend on the lidar: report them once.
        let is_of_wheels = |shown: &Shown| shown.fault.quantity.is_some_and(|q| q.is_of_wheels());
        shown.retain(|shown| place == 0 || !is_of_wheels(shown));
        shown
    });
    let mut shown: Vec<Shown> = shown.collect();
    let stands = shown.iter().any(|shown| shown.until.is_none());
    shown.retain(|shown| !stands || shown.until.is_none());
    let of_trips = || shown.iter().flat_map(|shown| &shown.trips);
    let trips: BTreeSet<&(TripId, StampNs, usize)> = of_trips().collect();
    let sound_until = shown.iter().map(|shown| shown.sound_until);
    Some(Suspect {
        vehicle: vehicle.clone(),
        since: of_trips().map(|(_, stamp, _)| *stamp).min()?,
        last_seen: of_trips().map(|(_, stamp, _)| *stamp).max()?,
        sound_until: sound_until.min().flatten(),
        until: shown.iter().filter_map(|shown| shown.until).max(),
        scans: trips.iter().map(|(_, _, scans)| *scans).sum(),
        trips: names(&trips),
        tier: match shown.iter().any(|shown| shown.is_confirmed) {
            true => Tier::Confirmed,
            false => Tier::Tentative,
        },
        significance: shown.iter().map(|s| s.significance).fold(0.0, f64::max),
        faults: shown.into_iter().map(|shown| shown.fault).collect(),
    })
}

/// Whether the scale of ranges that a lidar's trips show beside the map is shown by another
/// vehicle's too: as large, or half as large, and as sure.
fn is_of_map(
    calibrations: &Calibrations,
    vehicle: &VehicleId,
    calibration: &VehicleCalibration,
) -> bool {
    let own = match calibration.combined(Quantity::RangeScale) {
        Some(own) => own.estimate.value,
        None => return false,
    };
    let others = calibrations.vehicles().filter(|other| *other != vehicle);
    let mut lidars = others.flat_map(|other| calibrations.lidars_of(other));
    lidars.any(|(_, words)| {
        let other = VehicleCalibration::of(words.to_vec()).uncorrected();
        let other = other.get(&Quantity::RangeScale).copied();
        other.is_some_and(|other| other.value / own >= 0.5)
    })
}

/// A lidar whose scans do not fit the map while those of other vehicles do. If theirs do not fit either, the
/// map is wrong or the world has changed.
fn misfit(
    calibrations: &Calibrations,
    vehicle: &VehicleId,
    lidar: Option<&LidarId>,
    calibration: &VehicleCalibration,
) -> Option<Shown> {
    let (first, fit) = calibration.misfit()?;
    let others = calibrations.vehicles().filter(|other| *other != vehicle);
    let mut newest = others
        .flat_map(|other| calibrations.lidars_of(other))
        .filter_map(|(_, calibrations)| calibrations.last()?.calibration.map_fit);
    if newest.any(|fit| fit.fails()) {
        return None;
    }
    let text = format!(
        "its scans do not fit the map: of {} keyframes beside those of other vehicles {} have a loop \
         closure with them; ranges, mount or start poses are wrong",
        fit.near, fit.closed,
    );
    let fault = VehicleFault::uncorrectable(lidar.cloned(), &text);
    Some(lasting(calibration, fault, first))
}

fn names(trips: &BTreeSet<&(TripId, StampNs, usize)>) -> Vec<TripId> {
    let names: BTreeSet<&TripId> = trips.iter().map(|(trip, ..)| trip).collect();
    names.into_iter().cloned().collect()
}

/// The faults that one lidar's trips show.
fn shown_by(lidar: Option<&LidarId>, calibration: &VehicleCalibration) -> Vec<Shown> {
    let changes = calibration.changes().into_iter();
    let mut shown: Vec<Shown> = changes
        .map(|change| changed(lidar, calibration, &change))
        .collect();
    for (quantity, estimate) in calibration.unsteady() {
        let fault = VehicleFault::unsteady(lidar.cloned(), quantity, &estimate);
        shown.push(lasting(calibration, fault, 0));
    }
    for (quantity, estimate) in calibration.uncorrected() {
        let fault = VehicleFault::uncorrected(lidar.cloned(), quantity, &estimate);
        shown.push(lasting(calibration, fault, 0));
    }
    let (first, faults) = calibration.lasting_faults();
    for text in faults {
        let fault = VehicleFault::uncorrectable(lidar.cloned(), text);
        shown.push(lasting(calibration, fault, first));
    }
    shown
}

/// A fault that all trips since `first` show, without a change among them.
fn lasting(calibration: &VehicleCalibration, fault: VehicleFault, first: usize) -> Shown {
    Shown {
        fault,
        trips: trips(calibration, first..calibration.trips().len()),
        sound_until: None,
        until: None,
        is_confirmed: true,
        significance: LASTING_SIGNIFICANCE,
    }
}

fn changed(lidar: Option<&LidarId>, calibration: &VehicleCalibration, change: &Change) -> Shown {
    let stamp = |trip: usize| calibration.trips()[trip].stamp;
    Shown {
        fault: VehicleFault::changed(lidar.cloned(), change),
        trips: trips(calibration, change.trips.iter().copied()),
        sound_until: Some(stamp(change.last_before)),
        until: change.known_anew.map(stamp),
        is_confirmed: change.is_confirmed,
        significance: change.before.distance(&change.now),
    }
}

fn trips(
    calibration: &VehicleCalibration,
    places: impl Iterator<Item = usize>,
) -> Vec<(TripId, StampNs, usize)> {
    let known = places.map(|place| &calibration.trips()[place]);
    let of_trip = |trip: &crate::calibration::CalibratedTrip| {
        (trip.trip.clone(), trip.stamp, trip.scans as usize)
    };
    known.map(of_trip).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Estimate, MapFit, TripCalibration};
    use crate::store::TripCalibrationRecord;

    fn route(calibrations: &[TripCalibration]) -> Calibrations {
        let mut all = Calibrations::default();
        put(&mut all, "v", calibrations);
        all
    }

    fn put(all: &mut Calibrations, vehicle: &str, calibrations: &[TripCalibration]) {
        for (k, calibration) in calibrations.iter().enumerate() {
            all.put(&TripCalibrationRecord {
                trip_id: TripId::new(format!("{vehicle}{k:02}")).unwrap(),
                vehicle_id: VehicleId::new(vehicle).unwrap(),
                lidar: None,
                stamp: StampNs(10 * k as i64),
                scans: 150,
                calibration: calibration.clone(),
                beside_primary: None,
            })
            .unwrap();
        }
    }

    #[test]
    fn what_never_fits_is_suspected_unless_others_do_not_either() {
        let calibrations = |near, closed| {
            let word = TripCalibration {
                map_fit: Some(MapFit { near, closed }),
                ..TripCalibration::default()
            };
            vec![word; 2]
        };
        assert_eq!(
            suspects(&route(&calibrations(100, 0)[..1])),
            [],
            "one trip alone"
        );
        let mut all = route(&calibrations(100, 0));
        put(&mut all, "maker", &calibrations(0, 0));
        put(&mut all, "sound", &calibrations(100, 90));
        let found = suspects(&all);
        let [suspect] = found.as_slice() else {
            panic!("{found:?}");
        };
        assert_eq!((suspect.vehicle.as_str(), suspect.trips.len()), ("v", 2));
        assert!(suspect.faults[0].text.contains("of 100 keyframes"));
        put(&mut all, "w", &calibrations(100, 1));
        assert_eq!(suspects(&all), [], "the map is wrong, or all has changed");
    }

    fn yaw(value: f64) -> TripCalibration {
        let estimate = Estimate {
            value,
            sigma: 0.0015,
        };
        TripCalibration {
            estimates: [(Quantity::MountYaw, estimate)].into(),
            ..TripCalibration::default()
        }
    }

    #[test]
    fn a_knock_is_suspected_once_and_until_the_vehicle_is_known_anew() {
        let mut calibrations = vec![yaw(0.05), yaw(0.051), yaw(0.049), yaw(0.05)];
        assert_eq!(suspects(&route(&calibrations)), [], "off, always alike");
        for count in 1..=6 {
            calibrations.push(yaw(-0.01));
            let found = suspects(&route(&calibrations));
            let [suspect] = found.as_slice() else {
                panic!("{count}: {found:?}");
            };
            assert_eq!((suspect.trips.len(), suspect.faults.len()), (count, 1));
            assert_eq!(suspect.tier == Tier::Confirmed, count > 1);
            assert_eq!(suspect.sound_until, Some(StampNs(30)));
            assert_eq!(suspect.until, (count >= 4).then_some(StampNs(70)));
            assert_eq!(suspect.since, StampNs(40));
            assert!(
                suspect.faults[0].text.contains("changed from 2.86"),
                "{suspect:?}"
            );
        }
    }

    #[test]
    fn beams_that_are_off_are_told_and_not_corrected() {
        let estimate = Estimate {
            value: -0.04,
            sigma: 0.006,
        };
        let word = TripCalibration {
            estimates: [(Quantity::BeamSpacing, estimate)].into(),
            ..TripCalibration::default()
        };
        assert_eq!(suspects(&route(&vec![word.clone(); 3])), []);
        let told = suspects(&route(&vec![word; 4]));
        let fault = &told[0].faults[0];
        assert!(fault.text.contains("off by -4.00"), "{fault:?}");
        assert!(told[0].displacement().at_range_m(5.0) > 0.4);
    }

    #[test]
    fn ranges_too_short_are_told_of_one_vehicle_and_not_of_a_fleet() {
        let words = |value| {
            let estimate = Estimate {
                value,
                sigma: 0.002,
            };
            let word = TripCalibration {
                estimates: [(Quantity::RangeScale, estimate)].into(),
                ..TripCalibration::default()
            };
            vec![word; 4]
        };
        let mut all = route(&words(0.03));
        put(&mut all, "sound", &words(0.001));
        put(&mut all, "other-way", &words(-0.03));
        let told = suspects(&all);
        assert_eq!(told.len(), 2, "{told:?}");
        let text = &told[1].faults[0].text;
        assert!(
            text.contains("the scale of the ranges is off by 3.00"),
            "{text}"
        );
        put(&mut all, "w", &words(0.025));
        let told = suspects(&all);
        let left: Vec<&str> = told.iter().map(|one| one.vehicle.as_str()).collect();
        assert_eq!(left, ["other-way"]);
    }

    #[test]
    fn what_no_correction_mends_is_suspected_from_its_first_trip_on() {
        let slips = TripCalibration {
            faults: vec!["wheels slip".to_owned()],
            ..TripCalibration::default()
        };
        let mut calibrations = vec![yaw(0.0); 2];
        calibrations.extend(vec![slips; 3]);
        assert_eq!(suspects(&route(&calibrations)), []);
        calibrations.push(calibrations[4].clone());
        let found = suspects(&route(&calibrations));
        assert_eq!(found[0].faults[0].text, "wheels slip");
        assert_eq!((found[0].trips.len(), found[0].since), (4, StampNs(20)));
        assert_eq!((found[0].until, found[0].scans), (None, 600));
        let loose: Vec<_> = [0.06, -0.05, 0.05, -0.06].map(yaw).into();
        let found = suspects(&route(&loose));
        assert!(
            found[0].faults[0]
                .text
                .contains("differs from trip to trip"),
            "{found:?}"
        );
    }
}
