//! A scan's end points with the normals of the surfaces they lie on.

use super::{LaserScan, Lidar};
use crate::geometry::{Matrix2, Vector2};

/// Beams on each side that take part in a point's line, at least …
const NEIGHBOURS_MIN: usize = 3;
/// … and at most.
const NEIGHBOURS_MAX: usize = 24;
/// Between the two, beams take part up to this distance, in standard deviations of a range: on a
/// shorter line noise looks like a bend.
const LINE_REACH_SIGMAS: f64 = 15.0;
/// A neighbour lies on the same surface if it is not farther than this many beam spacings …
const GAP_SPACINGS: f64 = 6.0;
/// … or than this, metres.
const GAP_MIN_M: f64 = 0.12;
/// A line needs this many points.
const LINE_POINTS_MIN: usize = 3;
/// Largest ratio of the scatter across a line to the scatter along it.
const LINE_FLATNESS_MAX: f64 = 0.15;

/// Where a beam ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Metres, base frame.
    pub position: Vector2<f64>,
    /// Unit normal towards the lidar, base frame; `None` at corners, edges and lone points.
    pub normal: Option<Vector2<f64>>,
    /// Index of the beam.
    pub beam: usize,
    /// Measured range, metres.
    pub range_m: f64,
}

/// The scan's returns in beam order, in the base frame.
///
/// A normal is the direction of least scatter of the neighbouring returns on the same surface.
pub fn surface_points(scan: &LaserScan) -> Vec<SurfacePoint> {
    let lidar = scan.lidar();
    let (mount_sin, mount_cos) = lidar.mount.theta.sin_cos();
    let mut points: Vec<SurfacePoint> = Vec::with_capacity(scan.return_count());
    for beam in 0..scan.beam_count() {
        let Some(range_m) = scan.range_m(beam) else {
            continue;
        };
        let (sin, cos) = lidar.beam_angle_rad(beam).sin_cos();
        let (x, y) = (range_m * cos, range_m * sin);
        let position = Vector2::new(
            lidar.mount.x + mount_cos * x - mount_sin * y,
            lidar.mount.y + mount_sin * x + mount_cos * y,
        );
        points.push(SurfacePoint {
            position,
            normal: None,
            beam,
            range_m,
        });
    }
    let eye = lidar.mount.translation();
    for k in 0..points.len() {
        points[k].normal = line_normal(&points, k, lidar, &eye);
    }
    points
}

fn line_normal(
    points: &[SurfacePoint],
    k: usize,
    lidar: &Lidar,
    eye: &Vector2<f64>,
) -> Option<Vector2<f64>> {
    let centre = &points[k];
    let gap_m = (GAP_SPACINGS * lidar.angle_increment_rad * centre.range_m).max(GAP_MIN_M);
    let reach_m = LINE_REACH_SIGMAS * lidar.range_sigma_m;
    let same_surface = |a: &SurfacePoint, b: &SurfacePoint| {
        a.beam.abs_diff(b.beam) <= 2 && (a.position - b.position).norm() <= gap_m
    };
    let within_reach = |neighbours: usize, point: &SurfacePoint| {
        neighbours < NEIGHBOURS_MIN
            || neighbours < NEIGHBOURS_MAX && (point.position - centre.position).norm() <= reach_m
    };
    let mut first = k;
    while first > 0
        && within_reach(k - first, &points[first - 1])
        && same_surface(&points[first - 1], &points[first])
    {
        first -= 1;
    }
    let mut last = k;
    while last + 1 < points.len()
        && within_reach(last - k, &points[last + 1])
        && same_surface(&points[last + 1], &points[last])
    {
        last += 1;
    }
    let surface = &points[first..=last];
    if surface.len() < LINE_POINTS_MIN {
        return None;
    }
    let count = surface.len() as f64;
    let mean = surface.iter().map(|p| p.position).sum::<Vector2<f64>>() / count;
    let scatter = surface.iter().fold(Matrix2::zeros(), |sum, p| {
        let d = p.position - mean;
        sum + d * d.transpose()
    });
    let (across, along, normal) = least_axis(&scatter);
    if across > LINE_FLATNESS_MAX * LINE_FLATNESS_MAX * along {
        return None;
    }
    let towards_eye = (eye - centre.position).dot(&normal) >= 0.0;
    Some(if towards_eye { normal } else { -normal })
}

/// Eigenvalues (smaller, larger) of a symmetric matrix and the unit eigenvector of the smaller.
fn least_axis(m: &Matrix2<f64>) -> (f64, f64, Vector2<f64>) {
    let (a, b, c) = (m[(0, 0)], m[(0, 1)], m[(1, 1)]);
    let half_trace = 0.5 * (a + c);
    let radius = (0.5 * (a - c)).hypot(b);
    let axis_angle = 0.5 * (2.0 * b).atan2(a - c);
    let normal = Vector2::new(-axis_angle.sin(), axis_angle.cos());
    ((half_trace - radius).max(0.0), half_trace + radius, normal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;
    use std::sync::Arc;

    #[test]
    fn a_wall_ahead_of_a_turned_mount() {
        // The lidar looks along +y of the base; a wall stands 2 m ahead of the lidar.
        let lidar = Arc::new(Lidar {
            angle_min_rad: -0.3,
            angle_increment_rad: 0.02,
            range_min_m: 0.05,
            range_max_m: 10.0,
            mount: Pose2::new(0.5, 0.0, std::f64::consts::FRAC_PI_2),
            range_sigma_m: 0.01,
        });
        let ranges = (0..31).map(|k| Some(2.0 / lidar.beam_angle_rad(k).cos()));
        let scan = LaserScan::new(lidar.clone(), ranges).unwrap();
        let points = surface_points(&scan);
        assert_eq!(points.len(), 31);
        for point in points {
            assert!((point.position.y - 2.0).abs() < 2e-3);
            let normal = point.normal.unwrap();
            assert!(
                (normal - Vector2::new(0.0, -1.0)).norm() < 0.02,
                "{normal:?}"
            );
        }
    }

    #[test]
    fn a_lone_return_has_no_normal() {
        let lidar = Arc::new(Lidar {
            angle_min_rad: 0.0,
            angle_increment_rad: 0.02,
            range_min_m: 0.05,
            range_max_m: 10.0,
            mount: Pose2::IDENTITY,
            range_sigma_m: 0.01,
        });
        let scan = LaserScan::new(lidar, [None, Some(3.0), None]).unwrap();
        let points = surface_points(&scan);
        assert_eq!(points.len(), 1);
        assert_eq!(points[0].normal, None);
        assert_eq!(points[0].beam, 1);
    }

    /// A dense, noisy lidar 1.5 m before a wall: neighbouring beams end a centimetre apart.
    #[test]
    fn noise_takes_no_normals_from_a_near_wall() {
        for (beams, sigma_m) in [(181, 0.01), (361, 0.01), (721, 0.01), (361, 0.02)] {
            let lidar = Arc::new(Lidar {
                angle_min_rad: -0.8,
                angle_increment_rad: std::f64::consts::PI / (beams - 1) as f64,
                range_min_m: 0.05,
                range_max_m: 20.0,
                mount: Pose2::IDENTITY,
                range_sigma_m: sigma_m,
            });
            // Even noise of the stated standard deviation, by the golden ratio.
            let noise_m = |k: usize| ((k * k) as f64 * 0.618_034).fract() * 2.0 - 1.0;
            let ranges = (0..beams / 2).map(|k| {
                let to_wall_m = 1.5 / lidar.beam_angle_rad(k).cos();
                Some(to_wall_m + 3.0_f64.sqrt() * sigma_m * noise_m(k))
            });
            let scan = LaserScan::new(lidar.clone(), ranges.collect::<Vec<_>>()).unwrap();
            let points = surface_points(&scan);
            let straight = |n: &Vector2<f64>| (n - Vector2::new(-1.0, 0.0)).norm() < 0.2;
            let normals = points.iter().filter_map(|p| p.normal);
            let (count, good) = normals.fold((0, 0), |(count, good), n| {
                (count + 1, good + usize::from(straight(&n)))
            });
            let said = format!(
                "{beams}: {count} normals, {good} straight, of {}",
                points.len()
            );
            assert!(count * 10 >= points.len() * 9, "{said}");
            assert!(good * 10 >= count * 9, "{said}");
        }
    }
}
