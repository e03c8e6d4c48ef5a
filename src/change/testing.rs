//! Draws for tests.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A draw of the standard normal distribution.
pub(super) fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// A draw of χ² with some degrees of freedom.
pub(super) fn chi_squared(rng: &mut ChaCha8Rng, degrees: usize) -> f64 {
    (0..degrees).map(|_| gaussian(rng).powi(2)).sum()
}
