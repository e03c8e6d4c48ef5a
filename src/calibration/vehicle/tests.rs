use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::calibration::testing::{errors, lap, motions_along};
use crate::calibration::{Corrections, Spacing};

fn estimate(value: f64, sigma: f64) -> Estimate {
    Estimate { value, sigma }
}

fn vehicle_of(calibrations: impl IntoIterator<Item = TripCalibration>) -> VehicleCalibration {
    let trips = calibrations.into_iter().enumerate();
    let trips = trips.map(|(k, calibration)| CalibratedTrip {
        trip: TripId::new(format!("t{k}")).unwrap(),
        stamp: StampNs(k as i64),
        scans: 150,
        calibration,
    });
    VehicleCalibration::of(trips.collect())
}

fn yaw(value: f64) -> TripCalibration {
    TripCalibration {
        estimates: [(Quantity::MountYaw, estimate(value, 0.0015))].into(),
        ..TripCalibration::default()
    }
}

fn yaws(values: &[f64]) -> VehicleCalibration {
    vehicle_of(values.iter().map(|value| yaw(*value)))
}

#[test]
fn a_mount_that_was_knocked_is_not_corrected_until_it_is_known_anew() {
    let before = [0.03, 0.031, 0.029, 0.03];
    assert!(yaws(&before).sure().contains_key(&Quantity::MountYaw));
    assert_eq!(yaws(&before).changes(), []);
    let after = [-0.02, -0.021, -0.019, -0.02];
    for count in 1..=4 {
        let vehicle = yaws(&[&before[..], &after[..count]].concat());
        let [change] = &vehicle.changes()[..] else {
            panic!("{count}: {vehicle:?}");
        };
        assert!((change.before.value - 0.03).abs() < 1e-9 && change.now.value < -0.018);
        assert_eq!((change.last_before, change.trips.len()), (3, count));
        assert_eq!(change.is_confirmed, count > 1);
        assert_eq!(change.known_anew, (count == 4).then_some(7));
        let sure = vehicle.sure();
        assert_eq!(
            sure.contains_key(&Quantity::MountYaw),
            count == 4,
            "{count}"
        );
        assert!(sure.values().all(|now| (now.value + 0.02).abs() < 1e-3));
    }
}

#[test]
fn a_loose_mount_is_unsteady_and_a_steady_one_is_not() {
    let loose = yaws(&[0.05, -0.06, 0.055, -0.04, 0.07]);
    assert!(loose.sure().is_empty() && loose.changes().is_empty());
    let [(quantity, _)] = loose.unsteady()[..] else {
        panic!("{loose:?}");
    };
    assert_eq!(quantity, Quantity::MountYaw);
    for steady in [
        &[0.05, 0.051, 0.05, 0.049][..],
        &[0.01, -0.01, 0.012, -0.008],
        &[0.05; 3],
    ] {
        assert_eq!(yaws(steady).unsteady(), [], "{steady:?}");
    }
}

#[test]
fn the_newest_trips_count() {
    let old = std::iter::repeat_n(0.03, 25);
    let new = std::iter::repeat_n(-0.03, TRIPS_MAX);
    let vehicle = yaws(&old.chain(new).collect::<Vec<_>>());
    assert_eq!(vehicle.trips().len(), TRIPS_MAX);
    let combined = vehicle.combined(Quantity::MountYaw).unwrap();
    assert_eq!(combined.count, TRIPS_MAX);
    assert!((combined.estimate.value + 0.03).abs() < 1e-12);
    assert_eq!(combined.estimate.sigma, Quantity::MountYaw.floor());
    assert_eq!(vehicle.changes(), []);
}

#[test]
fn a_clock_is_never_corrected_twice() {
    let trip = TripCalibration {
        estimates: [(Quantity::ClockOffset, estimate(0.2, 0.003))].into(),
        ..TripCalibration::default()
    };
    let vehicle = vehicle_of(std::iter::repeat_n(trip, 6));
    assert!(vehicle.sure().is_empty() && vehicle.unsteady().is_empty());
    assert!(vehicle.combined(Quantity::ClockOffset).is_some());
}

#[test]
fn witnesses_that_disagree_are_reported_when_it_lasts() {
    let motions = motions_along(&lap(), &Corrections::default(), 1);
    let spacing = Spacing {
        by_matches: Some(estimate(-0.06, 0.003)),
        by_walls: Some(estimate(-0.03, 0.003)),
    };
    let trip = TripCalibration::of(&motions, Some(&spacing));
    let vehicle = vehicle_of([trip.clone()]);
    assert_eq!(
        (
            vehicle.newest_faults().len(),
            vehicle.lasting_faults().1.len()
        ),
        (1, 0)
    );
    assert!(vehicle.sure().is_empty());
    let vehicle = vehicle_of(std::iter::repeat_n(trip.clone(), 4));
    assert_eq!(vehicle.lasting_faults().1.len(), 1);
    let once_sound = [trip.clone(), trip.clone(), yaw(0.0), trip];
    assert_eq!(vehicle_of(once_sound).lasting_faults().1.len(), 0);
}

#[test]
fn wheels_that_slip_are_reported() {
    let motions = motions_along(&lap(), &Corrections::default(), 1);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let slipping = motions.by_scans().iter().map(|motion| {
        let mut slipped = *motion;
        slipped.motion.x += crate::sim::normal(&mut rng, 0.3);
        slipped.motion.theta += crate::sim::normal(&mut rng, 0.2);
        slipped
    });
    let motions = crate::calibration::Motions::new(
        *motions.mount(),
        motions.odometry().clone(),
        slipping.collect::<Vec<_>>(),
    );
    let trip = TripCalibration::of(&motions, None);
    assert_eq!(trip.faults.len(), 1, "{trip:?}");
    assert!(vehicle_of(std::iter::repeat_n(trip, 5)).sure().is_empty());
}

#[test]
fn sound_vehicles_stay_as_they_are_and_others_are_corrected() {
    let path = lap();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (mut corrected, mut worth) = (0, 0);
    for seed in 0..6_u64 {
        let sound = Corrections::default();
        let of = |truth: &Corrections, seed: u64| {
            let laps = (0..4).map(|lap| motions_along(&path, truth, 10 * seed + lap));
            vehicle_of(laps.map(|motions| TripCalibration::of(&motions, None)))
        };
        let vehicle = of(&sound, 100 + seed);
        assert!(vehicle.sure().is_empty(), "{:?}", vehicle.sure());
        assert_eq!((vehicle.changes(), vehicle.unsteady()), (vec![], vec![]));
        let truth = errors(&mut rng);
        let vehicle = of(&truth, 300 + seed);
        for (quantity, sure) in vehicle.sure() {
            let off = (sure.value - truth.get(quantity)).abs();
            assert!(off < 5.0 * sure.sigma, "{quantity:?}: {sure:?}");
            assert!(off < truth.get(quantity).abs(), "{quantity:?}: {sure:?}");
        }
        corrected += vehicle.sure().len();
        let is_worth =
            |q: &&Quantity| q.is_corrected() && truth.get(**q).abs() > 1.2 * q.applied_min();
        worth += Quantity::ALL.iter().filter(is_worth).count();
    }
    assert!(10 * corrected >= 8 * worth, "{corrected} of {worth}");
}
