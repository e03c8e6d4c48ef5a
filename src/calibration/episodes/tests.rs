use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::sim::normal;

const YAW: Quantity = Quantity::MountYaw;

fn samples(values: &[f64]) -> Vec<Sample> {
    let sample = |(trip, value): (usize, &f64)| Sample {
        trip,
        estimate: Estimate {
            value: *value,
            sigma: 0.0015,
        },
    };
    values.iter().enumerate().map(sample).collect()
}

fn episodes(values: &[f64]) -> Episodes {
    Episodes::of(YAW, samples(values))
}

fn trips(samples: &[Sample]) -> Vec<usize> {
    samples.iter().map(|sample| sample.trip).collect()
}

#[test]
fn four_trips_that_agree_are_sure_and_fewer_are_not() {
    let values = [0.030, 0.031, 0.029, 0.0305];
    assert_eq!(sure(YAW, &samples(&values[..3])), None);
    let known = sure(YAW, &samples(&values)).unwrap();
    assert!((known.value - 0.030125).abs() < 1e-9, "{known:?}");
    // Too small to be worth it, and too far apart for so few.
    assert_eq!(sure(YAW, &samples(&[0.006, 0.0061, 0.006, 0.006])), None);
    assert_eq!(sure(YAW, &samples(&[0.02, 0.03, 0.04, 0.03])), None);
    // The newest does not confirm the others, which are sure enough among themselves.
    let contradicted = [0.030, 0.0301, 0.0299, 0.030, 0.030, 0.030, 0.030, 0.012];
    assert!(sure(YAW, &samples(&contradicted[..7])).is_some());
    assert_eq!(sure(YAW, &samples(&contradicted)), None);
}

#[test]
fn turns_are_no_surer_than_the_spacing_of_the_beams_leaves_them() {
    let samples: Vec<Sample> = samples(&[0.0266, 0.024, 0.0259, 0.0259]);
    let with_sigma = |sigma: f64| -> Vec<Sample> {
        let sample = |sample: &Sample| Sample {
            estimate: Estimate {
                sigma,
                ..sample.estimate
            },
            ..*sample
        };
        samples.iter().map(sample).collect()
    };
    assert!(sure(Quantity::TurnScale, &with_sigma(0.007)).is_some());
    assert_eq!(sure(Quantity::TurnScale, &with_sigma(0.0165)), None);
}

#[test]
fn one_odd_trip_is_doubted_and_forgotten() {
    let doubted = episodes(&[0.03, 0.031, 0.029, 0.03, -0.02]);
    assert_eq!(
        (trips(&doubted.now), doubted.odd.map(|odd| odd.trip)),
        (vec![0, 1, 2, 3], Some(4))
    );
    let forgotten = episodes(&[0.03, 0.031, 0.029, 0.03, -0.02, 0.03]);
    assert_eq!(trips(&forgotten.now), [0, 1, 2, 3, 5]);
    assert_eq!((forgotten.odd, forgotten.before), (None, vec![]));
}

#[test]
fn two_trips_alike_are_a_change_and_a_mend_takes_it_back() {
    let changed = episodes(&[0.0, 0.001, -0.001, 0.05, 0.051]);
    assert_eq!(
        (trips(&changed.before), trips(&changed.now)),
        (vec![0, 1, 2], vec![3, 4])
    );
    let mended = episodes(&[0.0, 0.001, -0.001, 0.05, 0.051, 0.0]);
    assert_eq!(
        (trips(&mended.now), mended.before),
        (vec![0, 1, 2, 5], vec![])
    );
    // Known as well as before, it changes once more.
    let twice = episodes(&[0.0, 0.001, -0.001, 0.05, 0.051, 0.05, 0.0, 0.0]);
    assert_eq!(
        (trips(&twice.before), trips(&twice.now)),
        (vec![3, 4, 5], vec![6, 7])
    );
}

#[test]
fn what_scatters_as_one_is_no_change() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut seen = 0;
    for _ in 0..400 {
        // Three times what the trips say: lidars that tilt all day.
        let values: Vec<f64> = (0..8).map(|_| normal(&mut rng, 0.0045)).collect();
        for count in 1..=values.len() {
            let episodes = episodes(&values[..count]);
            seen += usize::from(episodes.odd.is_some() || !episodes.before.is_empty());
            assert_eq!(sure(YAW, &episodes.now), None, "{values:?}");
        }
    }
    assert_eq!(seen, 0);
}

proptest! {
    /// No sample counts twice, none is lost but for odd ones, and the order stays.
    #[test]
    fn every_word_is_somewhere(values in prop::collection::vec(-0.1..0.1_f64, 0..20)) {
        let episodes = episodes(&values);
        let before = trips(&episodes.before);
        let mut all = [before, trips(&episodes.now)].concat();
        all.extend(episodes.odd.map(|odd| odd.trip));
        prop_assert!(all.is_sorted_by(|a, b| a < b), "{:?}", all);
        prop_assert!(values.is_empty() || all.last() == Some(&(values.len() - 1)));
    }

    /// The sign of an error does not matter.
    #[test]
    fn left_is_as_right(values in prop::collection::vec(0.02..0.04_f64, 4..12)) {
        let turned: Vec<f64> = values.iter().map(|value| -value).collect();
        let (left, right) = (sure(YAW, &samples(&values)), sure(YAW, &samples(&turned)));
        prop_assert_eq!(left.map(|e| -e.value), right.map(|e| e.value));
    }
}
