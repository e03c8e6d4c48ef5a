use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::calibration::Spacing;
use crate::calibration::testing::{errors, lap, motions_along};

fn estimate(value: f64, sigma: f64) -> Estimate {
    Estimate { value, sigma }
}

fn trip_with_yaw(value: f64, sigma: f64) -> TripCalibration {
    TripCalibration {
        estimates: [(Quantity::MountYaw, estimate(value, sigma))].into(),
        ..TripCalibration::default()
    }
}

fn after(trips: impl IntoIterator<Item = TripCalibration>) -> VehicleCalibration {
    let begin = VehicleCalibration::default();
    trips
        .into_iter()
        .fold(begin, |vehicle, trip| vehicle.with_trip(trip))
}

#[test]
fn two_trips_that_agree_are_applied() {
    let (one, other) = (trip_with_yaw(0.03, 0.002), trip_with_yaw(0.033, 0.002));
    assert!(after([one.clone()]).applied().is_empty());
    let vehicle = after([one, other]);
    let applied = vehicle.applied()[&Quantity::MountYaw];
    assert!((applied.value - 0.0315).abs() < 1e-12);
    assert!((vehicle.corrections().get(Quantity::MountYaw) - 0.0315).abs() < 1e-12);
    // Too near 0, too uncertain, contradictory.
    for (first, second, sigma) in [
        (0.004, 0.004, 0.002),
        (0.1, 0.1, 0.02),
        (0.03, 0.041, 0.002),
    ] {
        let vehicle = after([trip_with_yaw(first, sigma), trip_with_yaw(second, sigma)]);
        assert!(vehicle.applied().is_empty(), "{first} {second} {sigma}");
    }
}

#[test]
fn the_halves_of_a_trip_are_enough() {
    let mut trip = trip_with_yaw(0.03, 0.002);
    trip.halves = [0.031, 0.029].map(|v| [(Quantity::MountYaw, estimate(v, 0.003))].into());
    assert_eq!(after([trip.clone()]).applied().len(), 1);
    trip.halves[1] = [(Quantity::MountYaw, estimate(0.01, 0.003))].into();
    assert!(after([trip]).applied().is_empty());
}

#[test]
fn a_mount_that_was_knocked_is_seen() {
    let before = [0.03, 0.031, 0.029].map(|yaw_rad| trip_with_yaw(yaw_rad, 0.002));
    let vehicle = after(before).with_trip(trip_with_yaw(-0.01, 0.002));
    let [change] = vehicle.changed() else {
        panic!("{vehicle:?}");
    };
    assert!((change.before.value - 0.03).abs() < 1e-12);
    assert_eq!(change.now.value, -0.01);
    assert!(vehicle.applied().is_empty());
    let vehicle = vehicle.with_trip(trip_with_yaw(-0.011, 0.002));
    assert!(vehicle.changed().is_empty());
    assert!((vehicle.applied()[&Quantity::MountYaw].value + 0.0105).abs() < 1e-12);
}

#[test]
fn what_scatters_from_trip_to_trip_is_not_applied() {
    // Each by itself far from 0, each far from the next.
    let yaws_rad = [0.03, -0.028, 0.033, -0.03, 0.012, 0.04, 0.02];
    for count in 2..=yaws_rad.len() {
        let vehicle = after(
            yaws_rad[..count]
                .iter()
                .map(|yaw| trip_with_yaw(*yaw, 0.002)),
        );
        assert!(vehicle.applied().is_empty(), "{count}: {vehicle:?}");
        assert!(
            count <= 3 || vehicle.changed().is_empty(),
            "{count}: {vehicle:?}"
        );
    }
}

#[test]
fn many_trips_are_forgotten_and_none_is_lost_on_the_way() {
    let trips = (0..3 * TRIPS_MAX).map(|k| trip_with_yaw(if k < 25 { 0.03 } else { -0.03 }, 0.003));
    let vehicle = after(trips);
    assert_eq!(vehicle.trips().len(), TRIPS_MAX);
    let combined = vehicle.combined(Quantity::MountYaw).unwrap();
    assert_eq!(combined.count, TRIPS_MAX);
    assert!((combined.estimate.value + 0.03).abs() < 1e-12);
    assert_eq!(combined.estimate.sigma, Quantity::MountYaw.floor());
}

#[test]
fn it_comes_back_from_json_as_it_was() {
    let vehicle = after([0.03, 0.029, -0.2].map(|yaw_rad| trip_with_yaw(yaw_rad, 0.002)));
    let text = serde_json::to_string(&vehicle).unwrap();
    assert!(text.contains("mount_yaw"), "{text}");
    let back: VehicleCalibration = serde_json::from_str(&text).unwrap();
    assert_eq!(back, vehicle);
}

#[test]
fn witnesses_that_disagree_are_reported() {
    let motions = motions_along(&lap(), &Corrections::default(), 1);
    let spacing = Spacing {
        by_matches: Some(estimate(-0.06, 0.003)),
        by_walls: Some(estimate(-0.03, 0.003)),
    };
    let vehicle = after([TripCalibration::of(&motions, Some(&spacing), None)]);
    assert_eq!(vehicle.uncorrectable().len(), 1);
    assert!(vehicle.applied().is_empty());
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
    let trip = TripCalibration::of(&motions, None, None);
    assert_eq!(trip.faults.len(), 1, "{trip:?}");
    assert!(after([trip]).applied().is_empty());
}

#[test]
fn sound_vehicles_stay_as_they_are_and_others_are_corrected() {
    let path = lap();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut corrected = 0;
    for seed in 0..10 {
        let sound = Corrections::default();
        let of = |truth: &Corrections, seed| {
            TripCalibration::of(&motions_along(&path, truth, seed), None, None)
        };
        let vehicle = after([of(&sound, 100 + seed), of(&sound, 200 + seed)]);
        assert!(vehicle.applied().is_empty(), "{:?}", vehicle.applied());
        let truth = errors(&mut rng);
        let vehicle = after([of(&truth, 300 + seed), of(&truth, 400 + seed)]);
        for (quantity, applied) in vehicle.applied() {
            let off = (applied.value - truth.get(*quantity)).abs();
            assert!(off < 5.0 * applied.sigma, "{quantity:?}: {applied:?}");
            assert!(
                off < truth.get(*quantity).abs(),
                "{quantity:?}: {applied:?}"
            );
        }
        corrected += vehicle.applied().len();
    }
    // Of seven values each, some too small to be worth it.
    assert!(corrected >= 40, "{corrected}");
}
