//! The outline of a set of points.

use crate::geometry::Vector2;

/// Corners of the octagon that is put round each point.
const CORNERS: usize = 8;

/// The convex hull of discs (octagons) round some points, counter-clockwise; empty without points.
pub fn region_round(points: &[Vector2<f64>], margin_m: f64) -> Vec<Vector2<f64>> {
    let turn = std::f64::consts::TAU / CORNERS as f64;
    let corners = (0..CORNERS).map(|k| {
        let (sin, cos) = ((k as f64 + 0.5) * turn).sin_cos();
        Vector2::new(cos, sin) * margin_m
    });
    let corners: Vec<Vector2<f64>> = corners.collect();
    let widened = convex_hull(points.to_vec())
        .into_iter()
        .flat_map(|point| corners.iter().map(move |corner| point + corner));
    convex_hull(widened.collect())
}

/// Andrew's monotone chain.
fn convex_hull(mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let mut hull = half_hull(points.iter());
    hull.pop();
    let mut upper = half_hull(points.iter().rev());
    upper.pop();
    hull.extend(upper);
    hull
}

fn half_hull<'a>(points: impl Iterator<Item = &'a Vector2<f64>>) -> Vec<Vector2<f64>> {
    let mut hull: Vec<Vector2<f64>> = Vec::new();
    for point in points {
        while let [.., before, last] = hull[..] {
            if (last - before).perp(&(point - last)) > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(*point);
    }
    hull
}

/// The centre of a simple polygon's area; the mean of its corners where it has none.
pub fn centroid(polygon: &[Vector2<f64>]) -> Vector2<f64> {
    let origin = polygon.first().copied().unwrap_or_default();
    let (mut area, mut moment) = (0.0, Vector2::zeros());
    for (k, corner) in polygon.iter().enumerate() {
        let a = corner - origin;
        let b = polygon[(k + 1) % polygon.len()] - origin;
        let cross = a.perp(&b);
        area += cross;
        moment += (a + b) * cross;
    }
    if area.abs() < 1e-12 {
        let sum: Vector2<f64> = polygon.iter().sum();
        return sum / polygon.len().max(1) as f64;
    }
    origin + moment / (3.0 * area)
}

/// Whether a point lies in a simple polygon (even–odd rule).
pub fn contains(polygon: &[Vector2<f64>], point: &Vector2<f64>) -> bool {
    let mut inside = false;
    for (k, a) in polygon.iter().enumerate() {
        let b = &polygon[(k + 1) % polygon.len()];
        let crosses = (a.y > point.y) != (b.y > point.y);
        if crosses && point.x < a.x + (b.x - a.x) * (point.y - a.y) / (b.y - a.y) {
            inside = !inside;
        }
    }
    inside
}
