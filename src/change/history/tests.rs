use super::*;
use proptest::prelude::*;

/// The best history of all, one by one.
fn brute_force(passes: &[f64]) -> (f64, f64) {
    let score = |states: u32| {
        let is_occupied = |k: usize| states >> k & 1 == 1;
        let gains = passes.iter().enumerate();
        let gained: f64 = gains
            .map(|(k, z)| if is_occupied(k) { 0.5 * z } else { -0.5 * z })
            .sum();
        let changes = (1..passes.len()).filter(|&k| is_occupied(k) != is_occupied(k - 1));
        gained - CHANGE_COST * changes.count() as f64
    };
    let all = 0..1_u32 << passes.len();
    let best = all.map(score).fold(f64::NEG_INFINITY, f64::max);
    (best, score(0).max(score(u32::MAX >> (32 - passes.len()))))
}

proptest! {
    #[test]
    fn the_best_of_all_histories(passes in proptest::collection::vec(-12.0..12.0_f64, 1..10)) {
        let history = History::of(passes.iter().copied());
        let (best, constant) = brute_force(&passes);
        prop_assert!((history.support - (best - constant)).abs() < 1e-9);
        let changes = history.states.windows(2).filter(|w| w[0] != w[1]).count();
        let gained: f64 = history.states.iter().zip(&passes).map(|(state, z)| match state {
            State::Occupied => 0.5 * z,
            State::Free => -0.5 * z,
        }).sum();
        prop_assert!((gained - CHANGE_COST * changes as f64 - best).abs() < 1e-9);
    }
}

#[test]
fn the_last_run_of_the_other_state() {
    let of = |passes: &[f64]| History::of(passes.iter().copied());
    assert_eq!(of(&[-9.0, -9.0, 9.0]).last_change(), Some(2..3));
    assert_eq!(of(&[-9.0, 9.0, 9.0, -9.0]).last_change(), Some(1..3));
    assert_eq!(
        of(&[-9.5, 9.5, -9.5, 9.5, 9.5, -9.5, -9.5]).last_change(),
        Some(3..5)
    );
    assert_eq!(of(&[9.0, -9.0]).baseline(), Some(State::Occupied));
    assert_eq!(of(&[-9.0, 1.0, -9.0]).last_change(), None);
    assert_eq!(of(&[]).last_change(), None);
}

#[test]
fn one_pass_says_no_more_than_its_limit() {
    assert!(limited(1_000.0, 10.0) <= 10.0 && limited(-1_000.0, 10.0) >= -10.0);
    assert!((limited(0.5, 10.0) - 0.5).abs() < 1e-3);
}
