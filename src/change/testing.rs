//! Draws and findings for tests.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{ChangeKind, Finding, Tier};
use crate::geometry::Vector2;
use crate::ids::{EdgeId, NodeId, StampNs, TripId};

/// Nanoseconds.
pub(super) const SECOND_NS: i64 = 1_000_000_000;

/// A square of this half width round a place, that one trip saw for nine seconds from second
/// `since_s` on.
pub(crate) fn finding(
    kind: ChangeKind,
    place: [f64; 2],
    half_width_m: f64,
    since_s: i64,
) -> Finding {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let location = Vector2::from(place);
    let corner = |c: [f64; 2]| location + half_width_m * Vector2::from(c);
    Finding {
        kind,
        location,
        sigma_m: 0.02,
        region: corners.map(corner).to_vec(),
        tier: Tier::Tentative,
        counterpart: None,
        shift: None,
        suspect: None,
        bands: Vec::new(),
        edges: vec![EdgeId(since_s)],
        nodes: vec![NodeId(since_s), NodeId(since_s + 1)],
        trips: vec![TripId::new("monday").unwrap()],
        views: 5,
        laps: 1,
        confidence: 0.99,
        since: StampNs(since_s * SECOND_NS),
        last_seen: StampNs((since_s + 9) * SECOND_NS),
        until: None,
    }
}

/// A draw of the standard normal distribution.
pub(super) fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// A draw of χ² with some degrees of freedom.
pub(super) fn chi_squared(rng: &mut ChaCha8Rng, degrees: usize) -> f64 {
    (0..degrees).map(|_| gaussian(rng).powi(2)).sum()
}
