//! Seeded random numbers.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::geometry::Vector2;

/// The purpose of a stream of random numbers. Streams of one seed are independent of each other: a change in
/// one does not change the others.
#[derive(Debug, Clone, Copy)]
pub(super) enum Purpose {
    World,
    /// Of a drive that begins with this lap.
    Ranges {
        from_lap: usize,
    },
    /// Of the lidar beside the first, on such a drive.
    CompanionRanges {
        from_lap: usize,
        lidar: usize,
    },
    Odometry {
        from_lap: usize,
    },
    Path {
        lap: usize,
    },
    Walker {
        lap: usize,
        walker: usize,
    },
    Changes {
        lap: usize,
    },
    /// What the scans of a lap share.
    PassErrors {
        lap: usize,
    },
    /// Doors that stand ajar in a lap.
    Doors {
        lap: usize,
    },
    /// How a scene's objects lean.
    Leans,
}

pub(super) fn stream(seed: u64, purpose: Purpose) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let of_lap = |lap: usize, number: u64| ((lap as u64) << 32) + number;
    rng.set_stream(match purpose {
        Purpose::World => 0,
        Purpose::Ranges { from_lap } => of_lap(from_lap, 1),
        Purpose::Odometry { from_lap } => of_lap(from_lap, 2),
        Purpose::Path { lap } => 1_000 + lap as u64,
        Purpose::Changes { lap } => of_lap(lap, 3),
        Purpose::PassErrors { lap } => of_lap(lap, 4),
        Purpose::Doors { lap } => of_lap(lap, 5),
        Purpose::Leans => 6,
        Purpose::CompanionRanges { from_lap, lidar } => of_lap(from_lap, 100 + lidar as u64),
        Purpose::Walker { lap, walker } => of_lap(lap + 1, 1_000 + walker as u64),
    });
    rng
}

/// A normal number with mean 0 (Box and Muller).
pub(crate) fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    // 1 − u lies in (0, 1]: the logarithm is finite.
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    sigma * radius * (TAU * rng.random::<f64>()).cos()
}

/// A point spread evenly over a disc round the origin.
pub(super) fn in_disc(rng: &mut ChaCha8Rng, radius_m: f64) -> Vector2<f64> {
    let radius_m = radius_m * rng.random::<f64>().sqrt();
    let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
    Vector2::new(radius_m * cos, radius_m * sin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_the_stated_spread() {
        let mut rng = stream(1, Purpose::World);
        let drawn: Vec<f64> = (0..20_000).map(|_| normal(&mut rng, 2.0)).collect();
        let mean = drawn.iter().sum::<f64>() / 20_000.0;
        let variance = drawn.iter().map(|v| v * v).sum::<f64>() / 20_000.0;
        let beyond_two_sigma = drawn.iter().filter(|v| v.abs() > 4.0).count();
        assert!(mean.abs() < 0.05, "{mean}");
        assert!((variance - 4.0).abs() < 0.15, "{variance}");
        assert!(
            (750..1_070).contains(&beyond_two_sigma),
            "{beyond_two_sigma}"
        );
    }

    #[test]
    fn streams_are_independent_and_repeatable() {
        let draw = |seed, purpose| stream(seed, purpose).random::<u64>();
        assert_eq!(
            draw(7, Purpose::Ranges { from_lap: 0 }),
            draw(7, Purpose::Ranges { from_lap: 0 })
        );
        assert_ne!(
            draw(7, Purpose::Ranges { from_lap: 0 }),
            draw(7, Purpose::Odometry { from_lap: 0 })
        );
        assert_ne!(
            draw(7, Purpose::Ranges { from_lap: 0 }),
            draw(8, Purpose::Ranges { from_lap: 0 })
        );
        assert_ne!(
            draw(7, Purpose::Path { lap: 0 }),
            draw(7, Purpose::Path { lap: 1 })
        );
    }
}
