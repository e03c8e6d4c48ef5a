use super::*;
use crate::calibration::testing::{SimulatedDrive, drive_with};
use crate::calibration::{Corrections, Spacing};

fn drive_of(factor: f64, seed: u64) -> SimulatedDrive {
    let truth = Corrections::default().with(Quantity::BeamSpacing, factor - 1.0);
    drive_with(&truth, seed, seed)
}

#[test]
fn a_wrong_spacing_is_found_by_both_witnesses() {
    for (seed, factor) in [(1, 0.95), (2, 1.0), (3, 1.06)] {
        let drive = drive_of(factor, seed);
        let spacing = Spacing::of(drive.scans(), &drive.pairs());
        for found in [spacing.by_matches.unwrap(), spacing.by_walls.unwrap()] {
            let off = found.value - (factor - 1.0);
            assert!(off.abs() < 0.004, "{factor}: {spacing:?}");
            assert!(found.sigma < 0.01, "{spacing:?}");
        }
        assert!(spacing.agreed().is_some());
    }
}

#[test]
fn without_pairs_nothing_is_known() {
    assert_eq!(spacing_by_matches(&[]), None);
}

#[test]
fn pairs_without_a_turn_are_left_out() {
    let drive = drive_of(1.05, 1);
    let pairs = drive.pairs().into_iter();
    let straight: Vec<_> = pairs
        .filter(|p| p.motion.theta.abs() < TURN_MIN_RAD)
        .collect();
    assert!(straight.len() > 20);
    assert_eq!(spacing_by_matches(&straight), None);
}
