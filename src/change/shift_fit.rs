//! The shift that lays points best onto others.

use std::collections::BTreeMap;

use super::{ChangeKind, Finding};
use crate::geometry::{Vector2, distance_to_polygon};

/// The longest shift that is considered, metres, …
pub const SHIFT_MAX_M: f64 = 1.5;
/// … and the shortest that explains anything, metres.
pub(super) const SHIFT_MIN_M: f64 = 0.1;
/// Shifts are tried in steps of this, metres, …
const STEP_M: f64 = 0.05;
/// … this many to each side of the expected direction, …
const STEPS_ASIDE: i32 = 3;
/// … and round the best of them in steps of this, metres, this many to each side.
const FINE_STEP_M: f64 = 0.01;
const FINE_STEPS: i32 = 5;
/// A point this far from all others does not fit at all, metres.
const FIT_M: f64 = 0.12;
/// One point is used in each square of this width, metres.
const THINNED_M: f64 = 0.05;
/// Fewest points on either side.
const POINTS_MIN: usize = 30;
/// A shift must fit better than none by this much; a fit is 1 if every point lies on another.
const GAIN_MIN: f64 = 0.03;
/// Points of a finding, as a share, that must lie on others for the shift to explain it.
const EXPLAINED_SHARE_MIN: f64 = 0.8;
/// Points this near to a finding's region belong to it, metres.
const OF_REGION_M: f64 = 0.05;

/// The shift at which a pass's points fit those of others best.
pub struct ShiftFit {
    shift: Vector2<f64>,
    old: Grid,
    new: Grid,
}

impl ShiftFit {
    /// Finds the shift that lays `new` points best onto `old` ones: up to 1.5 m along an expected direction,
    /// and a little aside; map frame, metres. `None` if it fits hardly better than no shift, or there are too
    /// few points.
    pub fn of(
        old: impl Iterator<Item = Vector2<f64>>,
        new: impl Iterator<Item = Vector2<f64>>,
        expected: &Vector2<f64>,
    ) -> Option<Self> {
        let (old, new) = (Grid::of(old), Grid::of(new));
        let along = expected.try_normalize(1e-9)?;
        let count = new.points().count();
        if old.points().count() < POINTS_MIN || count < POINTS_MIN {
            return None;
        }
        let fit = |shift: &Vector2<f64>| {
            let fits: f64 = new.points().map(|point| old.fit(&(point + shift))).sum();
            fits / count as f64
        };
        let aside = Vector2::new(-along.y, along.x);
        let steps = (SHIFT_MAX_M / STEP_M).round() as i32;
        let rough = (0..=steps).flat_map(|k| {
            let sideways = -STEPS_ASIDE..=STEPS_ASIDE;
            sideways.map(move |n| STEP_M * (f64::from(k) * along + f64::from(n) * aside))
        });
        let rough = best(rough, fit);
        let fine = (-FINE_STEPS..=FINE_STEPS).flat_map(|x| {
            let column = -FINE_STEPS..=FINE_STEPS;
            column.map(move |y| rough + FINE_STEP_M * Vector2::new(f64::from(x), f64::from(y)))
        });
        let shift = best(fine, fit);
        let gain = fit(&shift) - fit(&Vector2::zeros());
        (gain >= GAIN_MIN && shift.norm() >= SHIFT_MIN_M).then_some(Self { shift, old, new })
    }

    /// A shift without points; it explains no other finding.
    #[cfg(test)]
    pub(super) fn known(shift: Vector2<f64>) -> Self {
        let [old, new] = [(); 2].map(|()| Grid::of(std::iter::empty()));
        Self { shift, old, new }
    }

    /// The vector by which the new points have to be moved, map frame, metres.
    pub fn shift(&self) -> Vector2<f64> {
        self.shift
    }

    /// Whether the shift lays what appeared onto earlier points, or what disappeared onto points of the pass.
    pub fn explains(&self, finding: &Finding) -> bool {
        let (own, others, shift) = match finding.kind {
            ChangeKind::Appeared => (&self.new, &self.old, self.shift),
            ChangeKind::Disappeared => (&self.old, &self.new, -self.shift),
            _ => return false,
        };
        let of_finding =
            |point: &&Vector2<f64>| distance_to_polygon(point, &finding.region) <= OF_REGION_M;
        let (mut all, mut lying) = (0, 0);
        for point in own.points().filter(of_finding) {
            all += 1;
            lying += usize::from(others.fit(&(point + shift)) > 0.0);
        }
        all > 0 && lying as f64 >= EXPLAINED_SHARE_MIN * all as f64
    }
}

/// The shift that fits best; of equal ones the first.
fn best(
    shifts: impl Iterator<Item = Vector2<f64>>,
    fit: impl Fn(&Vector2<f64>) -> f64,
) -> Vector2<f64> {
    let none = (f64::NEG_INFINITY, Vector2::zeros());
    let best = shifts.fold(none, |best, shift| {
        let fits = fit(&shift);
        if fits > best.0 { (fits, shift) } else { best }
    });
    best.1
}

/// Some points by squares of [`FIT_M`], one of each square of [`THINNED_M`].
struct Grid(BTreeMap<(i64, i64), Vec<Vector2<f64>>>);

impl Grid {
    fn of(points: impl Iterator<Item = Vector2<f64>>) -> Self {
        // The smallest of each square: the result does not depend on the order of the points.
        let mut thinned: BTreeMap<(i64, i64), Vector2<f64>> = BTreeMap::new();
        for point in points {
            let kept = thinned.entry(square(&point, THINNED_M)).or_insert(point);
            let order = point.x.total_cmp(&kept.x);
            if order.then(point.y.total_cmp(&kept.y)).is_lt() {
                *kept = point;
            }
        }
        let mut squares: BTreeMap<(i64, i64), Vec<Vector2<f64>>> = BTreeMap::new();
        for point in thinned.into_values() {
            squares
                .entry(square(&point, FIT_M))
                .or_default()
                .push(point);
        }
        Self(squares)
    }

    fn points(&self) -> impl Iterator<Item = &Vector2<f64>> {
        self.0.values().flatten()
    }

    /// 1 on one of the points, 0 from [`FIT_M`] on.
    fn fit(&self, at: &Vector2<f64>) -> f64 {
        let (x, y) = square(at, FIT_M);
        let columns = x.saturating_sub(1)..=x.saturating_add(1);
        let rows = (y.saturating_sub(1), y.saturating_add(1));
        let near = columns.flat_map(|x| self.0.range((x, rows.0)..=(x, rows.1)));
        let squared = near.flat_map(|(_, points)| points.iter().map(|p| (p - at).norm_squared()));
        let nearest = squared.fold(f64::INFINITY, f64::min);
        (1.0 - nearest / (FIT_M * FIT_M)).max(0.0)
    }
}

fn square(point: &Vector2<f64>, width_m: f64) -> (i64, i64) {
    let of = |v: f64| (v / width_m).floor() as i64;
    (of(point.x), of(point.y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fitted_shift(
        old: impl Iterator<Item = Vector2<f64>>,
        new: impl Iterator<Item = Vector2<f64>>,
        expected: &Vector2<f64>,
    ) -> Option<Vector2<f64>> {
        ShiftFit::of(old, new, expected).map(|fit| fit.shift())
    }

    /// A corridor along x with posts of different widths that stand off its walls.
    fn corridor(off: Vector2<f64>) -> Vec<Vector2<f64>> {
        let wall = |y: f64| (0..400).map(move |k| Vector2::new(0.02 * f64::from(k), y));
        let posts = [(1.0, 0.3), (3.0, 0.1), (4.4, 0.5), (6.5, 0.2)];
        let posts = posts.into_iter().flat_map(|(x, width)| {
            let side = (0..=10).map(move |k| 0.1 * f64::from(k) * width);
            let across = side.clone().map(move |d| Vector2::new(x + d, 0.6));
            across.chain(side.flat_map(move |d| [x, x + width].map(|x| Vector2::new(x, 0.6 + d))))
        });
        let points = wall(-1.0).chain(wall(1.5)).chain(posts);
        points.map(|point| point + off).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn a_shift_along_a_corridor_is_found_whatever_stands_there(length_m in 0.15..1.2_f64) {
            let (old, new) = (corridor(Vector2::zeros()), corridor(Vector2::new(length_m, 0.0)));
            let expected = Vector2::new(-0.5, 0.03);
            let shift = fitted_shift(old.into_iter(), new.into_iter(), &expected);
            let off = shift.map(|shift| shift + Vector2::new(length_m, 0.0));
            prop_assert!(off.is_some_and(|off| off.norm() < 0.03), "{shift:?}");
        }
    }

    #[test]
    fn things_that_were_pushed_along_a_row_that_stands_are_no_shift() {
        let mut new = corridor(Vector2::zeros());
        let mut old = new.clone();
        let cart = |x: f64| (0..20).map(move |k| Vector2::new(x, 0.2 + 0.02 * f64::from(k)));
        old.extend([2.0, 3.9, 6.0].into_iter().flat_map(cart));
        new.extend([2.4, 4.3, 6.4].into_iter().flat_map(cart));
        let expected = Vector2::new(-0.4, 0.0);
        let shift = fitted_shift(old.into_iter(), new.into_iter(), &expected);
        assert_eq!(shift, None);
    }

    #[test]
    fn nothing_tells_nothing() {
        let points = || corridor(Vector2::zeros()).into_iter();
        let expected = Vector2::new(0.4, 0.0);
        assert_eq!(fitted_shift(points(), points(), &expected), None);
        assert_eq!(fitted_shift(points(), points().take(5), &expected), None);
        assert_eq!(fitted_shift(points().take(5), points(), &expected), None);
        assert_eq!(fitted_shift(points(), points(), &Vector2::zeros()), None);
    }
}
