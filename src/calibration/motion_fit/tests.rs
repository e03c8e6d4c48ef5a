use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::calibration::motion_model::UNKNOWNS;
use crate::calibration::testing::{errors, lap, motions_along, straight};

/// So many of its 3,200 poses: 45 m with three bends.
const LAP_PART: usize = 1_300;

#[test]
fn errors_are_found_and_their_errors_are_honest() {
    let path = &lap()[..LAP_PART];
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let vehicles = 40;
    let mut squares = [0.0; UNKNOWNS];
    for seed in 0..vehicles {
        let truth = errors(&mut rng);
        let fit = fit_motions(&motions_along(path, &truth, seed)).unwrap();
        for (k, quantity) in Quantity::ALL.into_iter().take(UNKNOWNS).enumerate() {
            let found = fit.estimates[&quantity];
            let normalised = (found.value - truth.get(quantity)) / found.sigma;
            assert!(normalised.abs() < 5.0, "{quantity:?}: {found:?} {truth:?}");
            squares[k] += normalised * normalised / vehicles as f64;
        }
        assert!(fit.excess < 1.2, "{fit:?}");
    }
    for (quantity, square) in Quantity::ALL.into_iter().zip(squares) {
        println!("{quantity:?}: {:.2}", square.sqrt());
    }
    for (quantity, square) in Quantity::ALL.into_iter().zip(squares) {
        assert!(
            (0.5..1.6).contains(&square.sqrt()),
            "{quantity:?}: {square}"
        );
    }
}

#[test]
fn what_a_straight_drive_does_not_show_is_unknown() {
    let truth = Corrections::default()
        .with(Quantity::MountYaw, 0.03)
        .with(Quantity::MountX, 0.1)
        .with(Quantity::WayScale, 0.02);
    for seed in 0..10 {
        let fit = fit_motions(&motions_along(&straight(), &truth, seed)).unwrap();
        let known: Vec<Quantity> = fit.estimates.keys().copied().collect();
        for unknown in [Quantity::MountX, Quantity::MountY, Quantity::TurnScale] {
            assert!(!known.contains(&unknown), "{:?}", fit.estimates);
        }
        for shown in [Quantity::MountYaw, Quantity::WayScale] {
            let found = fit.estimates[&shown];
            let off = found.value - truth.get(shown);
            assert!(off.abs() < 4.0 * found.sigma, "{shown:?}: {found:?}");
        }
    }
}

#[test]
fn at_an_even_speed_straight_on_no_clock_offset_shows() {
    let even: Vec<_> = (0..2_000)
        .map(|k| {
            let way_m = 0.03 * f64::from(k);
            let stamp = crate::ids::StampNs(50_000_000 * i64::from(k));
            (stamp, crate::geometry::Pose2::new(way_m, 0.0, 0.0))
        })
        .collect();
    let truth = Corrections::default().with(Quantity::ClockOffset, 0.2);
    for seed in 0..10 {
        let fit = fit_motions(&motions_along(&even, &truth, seed)).unwrap();
        let found = fit.estimates.get(&Quantity::ClockOffset);
        assert_eq!(found, None, "{fit:?}");
    }
}

#[test]
fn an_offset_beyond_reach_is_unknown() {
    let truth = Corrections::default()
        .with(Quantity::ClockOffset, 0.8)
        .with(Quantity::MountYaw, 0.03);
    let fit = fit_motions(&motions_along(&lap(), &truth, 3)).unwrap();
    assert_eq!(fit.estimates.get(&Quantity::ClockOffset), None, "{fit:?}");
    assert!(fit.corrections.get(Quantity::ClockOffset).abs() < 1e-9);
    assert!((fit.estimates[&Quantity::MountYaw].value - 0.03).abs() < 0.01);
}

#[test]
fn too_few_motions_say_nothing() {
    let path = lap();
    let motions = motions_along(&path[..200], &Corrections::default(), 1);
    assert!(motions.by_scans().len() < MOTIONS_MIN);
    assert!(fit_motions(&motions).is_none());
}
