//! Distances of simple polygons. A polygon is its corners in order, not closed; one of two
//! corners is a segment, one of one corner a point, and one without corners is nowhere.

use super::Vector2;

/// The distance of a point from a polygon: 0 inside and on its border, infinite if it has no
/// corners.
pub fn distance_to_polygon(point: &Vector2<f64>, polygon: &[Vector2<f64>]) -> f64 {
    if contains(polygon, point) {
        return 0.0;
    }
    sides(polygon)
        .map(|(a, b)| distance_to_segment(point, &a, &b))
        .fold(f64::INFINITY, f64::min)
}

/// The least distance of two polygons: 0 if they share a point, infinite if one has no corners.
pub fn polygon_gap(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> f64 {
    let crossing = sides(a).any(|(p, q)| sides(b).any(|(r, s)| segments_cross(&p, &q, &r, &s)));
    if crossing {
        return 0.0;
    }
    // Apart, or one inside the other: the least distance is at a corner of one of them.
    let from_a = a.iter().map(|corner| distance_to_polygon(corner, b));
    let from_b = b.iter().map(|corner| distance_to_polygon(corner, a));
    from_a.chain(from_b).fold(f64::INFINITY, f64::min)
}

/// The area that a polygon encloses, square units.
pub fn polygon_area(polygon: &[Vector2<f64>]) -> f64 {
    let twice: f64 = sides(polygon).map(|(a, b)| a.perp(&b)).sum();
    0.5 * twice.abs()
}

/// Whether the sides of a polygon of three corners or more meet at its corners alone, two at each.
pub fn is_simple_polygon(polygon: &[Vector2<f64>]) -> bool {
    let sides: Vec<_> = sides(polygon).collect();
    let count = sides.len();
    if count < 3 {
        return false;
    }
    let pairs = (0..count).flat_map(|k| (k + 1..count).map(move |other| (k, other)));
    pairs.into_iter().all(|(k, other)| {
        let ((a, b), (c, d)) = (sides[k], sides[other]);
        if other == k + 1 {
            // They share b: neither goes back over the other.
            distance_to_segment(&a, &c, &d) > 0.0 && distance_to_segment(&d, &a, &b) > 0.0
        } else if k == 0 && other == count - 1 {
            distance_to_segment(&b, &c, &d) > 0.0 && distance_to_segment(&c, &a, &b) > 0.0
        } else {
            polygon_gap(&[a, b], &[c, d]) > 0.0
        }
    })
}

fn sides(polygon: &[Vector2<f64>]) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + '_ {
    let next = polygon.iter().cycle().skip(1);
    polygon.iter().zip(next).map(|(a, b)| (*a, *b))
}

/// By the parity of the borders that a ray along +x crosses.
fn contains(polygon: &[Vector2<f64>], point: &Vector2<f64>) -> bool {
    let crossed = sides(polygon).filter(|(a, b)| {
        (a.y > point.y) != (b.y > point.y)
            && point.x < (b.x - a.x) * (point.y - a.y) / (b.y - a.y) + a.x
    });
    crossed.count() % 2 == 1
}

fn distance_to_segment(point: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let along = b - a;
    let length2 = along.norm_squared();
    let share = if length2 > 0.0 {
        ((point - a).dot(&along) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (point - (a + along * share)).norm()
}

/// Whether two segments cross in their insides; touching is found by distances.
fn segments_cross(p: &Vector2<f64>, q: &Vector2<f64>, r: &Vector2<f64>, s: &Vector2<f64>) -> bool {
    let side = |a: &Vector2<f64>, b: &Vector2<f64>, c: &Vector2<f64>| (b - a).perp(&(c - a));
    side(p, q, r) * side(p, q, s) < 0.0 && side(r, s, p) * side(r, s, q) < 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rectangle(x: f64, y: f64, width: f64, height: f64) -> Vec<Vector2<f64>> {
        [
            [x, y],
            [x + width, y],
            [x + width, y + height],
            [x, y + height],
        ]
        .map(Vector2::from)
        .to_vec()
    }

    #[test]
    fn a_hollow_is_outside() {
        let u = [
            [0.0, 0.0],
            [3.0, 0.0],
            [3.0, 3.0],
            [2.0, 3.0],
            [2.0, 1.0],
            [1.0, 1.0],
            [1.0, 3.0],
            [0.0, 3.0],
        ]
        .map(Vector2::from);
        assert_eq!(distance_to_polygon(&Vector2::new(1.5, 2.0), &u), 0.5);
        assert_eq!(distance_to_polygon(&Vector2::new(0.5, 2.0), &u), 0.0);
        assert_eq!(polygon_gap(&u, &rectangle(1.25, 1.5, 0.5, 0.5)), 0.25);
    }

    #[test]
    fn degenerate_polygons_have_distances() {
        let point = [Vector2::new(3.0, 4.0)];
        let segment = [Vector2::new(0.0, 0.0), Vector2::new(0.0, 9.0)];
        assert_eq!(distance_to_polygon(&Vector2::zeros(), &point), 5.0);
        assert_eq!(polygon_gap(&point, &segment), 3.0);
        assert_eq!(polygon_gap(&[], &segment), f64::INFINITY);
        assert_eq!(polygon_gap(&segment, &[]), f64::INFINITY);
    }

    #[test]
    fn a_simple_polygon_does_not_meet_itself() {
        let of = |corners: &[[f64; 2]]| -> Vec<_> {
            corners.iter().copied().map(Vector2::from).collect()
        };
        let square = rectangle(1.0, 1.0, 2.0, 3.0);
        assert!(is_simple_polygon(&square));
        assert_eq!(polygon_area(&square), 6.0);
        let reversed: Vec<_> = square.iter().rev().copied().collect();
        assert!(is_simple_polygon(&reversed));
        assert_eq!(polygon_area(&reversed), 6.0);
        for faulty in [
            of(&[[0.0, 0.0], [1.0, 0.0]]),
            // A bow tie; a side twice; a corner on another side; a corner twice; closed; in a line.
            of(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]),
            of(&[[0.0, 0.0], [2.0, 0.0], [1.0, 0.0], [1.0, 1.0]]),
            of(&[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.0]]),
            of(&[[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
            of(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]),
            of(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]),
        ] {
            assert!(!is_simple_polygon(&faulty), "{faulty:?}");
        }
    }

    proptest! {
        /// For axis-parallel rectangles the gap has a formula of its own.
        #[test]
        fn gaps_of_rectangles(
            x in -3.0..3.0_f64, y in -3.0..3.0_f64, w in 0.1..2.0_f64, h in 0.1..2.0_f64,
        ) {
            let (a, b) = (rectangle(0.0, 0.0, 1.0, 0.5), rectangle(x, y, w, h));
            let apart = |low: f64, high: f64, extent: f64| (low - extent).max(-high).max(0.0);
            let expected = apart(x, x + w, 1.0).hypot(apart(y, y + h, 0.5));
            prop_assert!((polygon_gap(&a, &b) - expected).abs() < 1e-12);
            prop_assert_eq!(polygon_gap(&a, &b), polygon_gap(&b, &a));
        }
    }
}
