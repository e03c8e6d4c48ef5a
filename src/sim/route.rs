//! Closed routes with rounded corners.

use rand_chacha::ChaCha8Rng;

use super::random::in_disc;
use crate::geometry::{Pose2, Vector2, wrap_angle};

/// Distance between two independent offsets of a noisy path, metres.
const OFFSET_SPACING_M: f64 = 4.0;
/// Step over which a noisy path's direction is taken, metres.
const DIRECTION_STEP_M: f64 = 0.05;

/// A closed path through a world, driven in the order of its corners.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    pieces: Vec<Piece>,
    length_m: f64,
}

/// Why corners make no route.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RouteError {
    /// Fewer than three corners.
    #[error("a closed route needs at least three corners")]
    TooFewCorners,
    /// Two corners on one spot, or a turn back on the spot.
    #[error("the route cannot be rounded at corner {0}")]
    SharpCorner(usize),
}

/// A straight or an arc of constant curvature.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece {
    start: Pose2,
    length_m: f64,
    /// Radians a metre, positive to the left.
    curvature: f64,
}

impl Piece {
    fn pose_at(&self, way_m: f64) -> Pose2 {
        let tangent = nalgebra::Vector3::new(way_m, 0.0, self.curvature * way_m);
        self.start.compose(&Pose2::exp(&tangent))
    }
}

impl Route {
    /// A route through corners that are rounded with `corner_radius_m`, or with less where the
    /// legs are too short for it. It starts in the middle of the first leg.
    ///
    /// # Errors
    /// [`RouteError`] if the corners do not make a closed route.
    pub fn new(corners: &[Vector2<f64>], corner_radius_m: f64) -> Result<Self, RouteError> {
        let count = corners.len();
        if count < 3 {
            return Err(RouteError::TooFewCorners);
        }
        let mut pieces = Vec::with_capacity(2 * count + 1);
        let middle = |k: usize| 0.5 * (corners[k % count] + corners[(k + 1) % count]);
        for k in 0..count {
            let (from, corner, to) = (middle(k), corners[(k + 1) % count], middle(k + 1));
            let rounded = rounded_corner(&from, &corner, &to, corner_radius_m)
                .ok_or(RouteError::SharpCorner((k + 1) % count))?;
            pieces.extend(rounded.into_iter().filter(|p| p.length_m > 0.0));
        }
        let length_m = pieces.iter().map(|p| p.length_m).sum();
        Ok(Self { pieces, length_m })
    }

    /// Length of a lap, metres.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// The pose after `way_m` from the start, facing along the route.
    pub fn pose_at(&self, way_m: f64) -> Pose2 {
        let mut left_m = way_m.rem_euclid(self.length_m);
        for piece in &self.pieces {
            if left_m <= piece.length_m {
                return piece.pose_at(left_m);
            }
            left_m -= piece.length_m;
        }
        self.pieces.first().map_or(Pose2::IDENTITY, |p| p.start)
    }

    /// One lap beside the route: poses every `spacing_m` of the route, shifted smoothly by
    /// independent offsets that are spread evenly over a disc of `path_noise_m` (the paper's ρ,
    /// section 5.1). The lap starts and ends on the route.
    pub(super) fn lap(
        &self,
        spacing_m: f64,
        path_noise_m: f64,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Pose2> {
        let segments = ((self.length_m / OFFSET_SPACING_M).round() as usize).max(2);
        let mut offsets = vec![Vector2::zeros(); segments + 1];
        for offset in &mut offsets[1..segments] {
            *offset = in_disc(rng, path_noise_m);
        }
        let position = |way_m: f64| {
            let place = way_m / self.length_m * segments as f64;
            self.pose_at(way_m).translation() + blend(&offsets, place)
        };
        let count = (self.length_m / spacing_m).floor().max(1.0) as usize;
        let pose = |k: usize| {
            let way_m = k as f64 * self.length_m / count as f64;
            let on_route = self.pose_at(way_m);
            if path_noise_m == 0.0 {
                return on_route;
            }
            let here = position(way_m);
            let ahead = position(way_m + DIRECTION_STEP_M) - position(way_m - DIRECTION_STEP_M);
            Pose2::new(here.x, here.y, ahead.y.atan2(ahead.x))
        };
        (0..count).map(pose).collect()
    }
}

/// From `from` straight to the corner's arc, along it, and straight on to `to`.
fn rounded_corner(
    from: &Vector2<f64>,
    corner: &Vector2<f64>,
    to: &Vector2<f64>,
    radius_m: f64,
) -> Option<[Piece; 3]> {
    let (leg_in, leg_out) = (corner - from, to - corner);
    let (length_in, length_out) = (leg_in.norm(), leg_out.norm());
    let heading_in = leg_in.y.atan2(leg_in.x);
    let turn = wrap_angle(leg_out.y.atan2(leg_out.x) - heading_in);
    let tangent_share = (0.5 * turn.abs()).tan();
    if length_in.min(length_out) <= 0.0 || tangent_share > 1e3 {
        return None;
    }
    let cut_m = (radius_m * tangent_share).min(length_in).min(length_out);
    let (arc_m, curvature) = if cut_m > 0.0 {
        let radius_m = cut_m / tangent_share;
        (radius_m * turn.abs(), turn.signum() / radius_m)
    } else {
        (0.0, 0.0)
    };
    let straight_in = Piece {
        start: Pose2::new(from.x, from.y, heading_in),
        length_m: length_in - cut_m,
        curvature: 0.0,
    };
    let arc = Piece {
        start: straight_in.pose_at(straight_in.length_m),
        length_m: arc_m,
        curvature,
    };
    let after = corner + leg_out * (cut_m / length_out);
    let straight_out = Piece {
        start: Pose2::new(after.x, after.y, heading_in + turn),
        length_m: length_out - cut_m,
        curvature: 0.0,
    };
    Some([straight_in, arc, straight_out])
}

/// The offset at a place between the given ones, with a continuous direction; none outside.
fn blend(offsets: &[Vector2<f64>], place: f64) -> Vector2<f64> {
    let last = offsets.len() - 1;
    if place <= 0.0 || place >= last as f64 {
        return Vector2::zeros();
    }
    let k = place as usize;
    let share = place - k as f64;
    let eased = share * share * (3.0 - 2.0 * share);
    offsets[k] * (1.0 - eased) + offsets[k + 1] * eased
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::random::{Purpose, stream};
    use std::f64::consts::{FRAC_PI_2, TAU};

    fn corners(points: &[(f64, f64)]) -> Vec<Vector2<f64>> {
        points.iter().map(|&(x, y)| Vector2::new(x, y)).collect()
    }

    fn rectangle() -> Route {
        let corners = corners(&[(0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (0.0, 6.0)]);
        Route::new(&corners, 1.0).unwrap()
    }

    #[test]
    fn a_rounded_rectangle() {
        let route = rectangle();
        assert!((route.length_m() - (32.0 - 8.0 + TAU)).abs() < 1e-9);
        let start = route.pose_at(0.0);
        assert!((start.x - 5.0).abs() < 1e-12 && start.y.abs() < 1e-12 && start.theta == 0.0);
        let on_arc = route.pose_at(4.0 + 0.5 * FRAC_PI_2);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((on_arc.x - (9.0 + half)).abs() < 1e-9, "{on_arc:?}");
        assert!((on_arc.y - (1.0 - half)).abs() < 1e-9, "{on_arc:?}");
        let lap_later = route.pose_at(route.length_m() + 1.0);
        assert!((lap_later.x - 6.0).abs() < 1e-9);
    }

    #[test]
    fn a_lap_is_continuous_in_place_and_direction() {
        // Right turns, left turns and a leg too short for the radius.
        let corners = corners(&[
            (0.0, 0.0),
            (12.0, 0.0),
            (12.0, 8.0),
            (7.0, 8.0),
            (7.0, 6.5),
            (0.0, 6.5),
        ]);
        let route = Route::new(&corners, 2.0).unwrap();
        for (rho, step_max) in [(0.0, 0.051), (0.5, 0.1)] {
            let mut rng = stream(5, Purpose::Path { lap: 1 });
            let lap = route.lap(0.05, rho, &mut rng);
            for (a, b) in lap.iter().zip(lap.iter().cycle().skip(1)) {
                let moved = a.between(b);
                assert!(moved.translation().norm() <= step_max, "{a:?} {b:?}");
                assert!(moved.theta.abs() < 0.25, "{a:?} {b:?}");
                assert!(moved.y.abs() < 0.02, "moves where it looks: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn a_noisy_lap_stays_near_the_route() {
        let route = rectangle();
        let mut rng = stream(6, Purpose::Path { lap: 1 });
        let lap = route.lap(0.25, 0.5, &mut rng);
        let off: Vec<f64> = (0..lap.len())
            .map(|k| {
                let way = k as f64 * route.length_m() / lap.len() as f64;
                (lap[k].translation() - route.pose_at(way).translation()).norm()
            })
            .collect();
        let largest = off.iter().copied().fold(0.0, f64::max);
        assert!(largest <= 0.5 && largest > 0.2, "{largest}");
        assert_eq!(off[0], 0.0);
    }

    #[test]
    fn what_is_no_route_is_refused() {
        let line = corners(&[(0.0, 0.0), (1.0, 0.0)]);
        assert_eq!(Route::new(&line, 1.0), Err(RouteError::TooFewCorners));
        let back = corners(&[(0.0, 0.0), (4.0, 0.0), (2.0, 0.0)]);
        assert_eq!(Route::new(&back, 1.0), Err(RouteError::SharpCorner(1)));
        let double = corners(&[(0.0, 0.0), (4.0, 0.0), (4.0, 0.0), (0.0, 4.0)]);
        assert!(matches!(
            Route::new(&double, 1.0),
            Err(RouteError::SharpCorner(_))
        ));
    }
}
