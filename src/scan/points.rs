//! A scan's end points with the normals of the surfaces they lie on.

use super::LaserScan;
use super::line::LineWindow;
use crate::geometry::Vector2;

/// Beams on each side that take part in a point's line, at least …
const NEIGHBOURS_MIN: usize = 3;
/// … and at most.
const NEIGHBOURS_MAX: usize = 24;
/// Between the two, beams take part up to this distance, in standard deviations of a range: on a
/// shorter line noise looks like a bend.
const LINE_REACH_SIGMAS: f64 = 15.0;
/// Two returns lie on the same surface if they are not farther apart than this many beam spacings
/// at the nearer one …
const GAP_SPACINGS: f64 = 6.0;
/// … or than this, metres.
const GAP_MIN_M: f64 = 0.12;
/// … and if at most one beam between them has no return.
const BEAM_STEP_MAX: usize = 2;

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
    let mut points = end_points(scan);
    let lidar = scan.lidar();
    let gap_per_range = GAP_SPACINGS * lidar.angle_increment_rad;
    let reach_m = LINE_REACH_SIGMAS * lidar.range_sigma_m;
    let eye = lidar.mount.translation();
    let surfaces = points.chunk_by_mut(|a, b| {
        let gap_m = (gap_per_range * a.range_m.min(b.range_m)).max(GAP_MIN_M);
        b.beam - a.beam <= BEAM_STEP_MAX
            && (b.position - a.position).norm_squared() <= gap_m * gap_m
    });
    for surface in surfaces {
        set_normals(surface, reach_m, &eye);
    }
    points
}

/// Each beam's direction is that of the beam before it, turned: after thousands of beams it is off
/// by 10⁻¹² rad.
fn end_points(scan: &LaserScan) -> Vec<SurfacePoint> {
    let lidar = scan.lidar();
    let eye = lidar.mount.translation();
    let (first_sin, first_cos) = (lidar.mount.theta + lidar.angle_min_rad).sin_cos();
    let (step_sin, step_cos) = lidar.angle_increment_rad.sin_cos();
    let mut direction = Vector2::new(first_cos, first_sin);
    let tick_m = lidar.tick_m();
    let mut points = Vec::with_capacity(scan.return_count());
    for (beam, &ticks) in scan.ticks().iter().enumerate() {
        if ticks > 0 {
            let range_m = f64::from(ticks) * tick_m;
            points.push(SurfacePoint {
                position: eye + direction * range_m,
                normal: None,
                beam,
                range_m,
            });
        }
        direction = Vector2::new(
            direction.x * step_cos - direction.y * step_sin,
            direction.x * step_sin + direction.y * step_cos,
        );
    }
    points
}

/// Fits a line round each point of one surface.
fn set_normals(surface: &mut [SurfacePoint], reach_m: f64, eye: &Vector2<f64>) {
    let Some(first) = surface.first() else {
        return;
    };
    let origin = first.position;
    let mut window = LineWindow::default();
    // The points `from..to` are in the window.
    let (mut from, mut to) = (0, 0);
    for k in 0..surface.len() {
        let centre = surface[k].position;
        let takes_part = |neighbours: usize, other: &SurfacePoint| {
            neighbours <= NEIGHBOURS_MIN
                || neighbours <= NEIGHBOURS_MAX
                    && (other.position - centre).norm_squared() <= reach_m * reach_m
        };
        while to < surface.len() && (to <= k || takes_part(to - k, &surface[to])) {
            window.add(&(surface[to].position - origin));
            to += 1;
        }
        while from < k && !takes_part(k - from, &surface[from]) {
            window.remove(&(surface[from].position - origin));
            from += 1;
        }
        surface[k].normal = window.normal().map(|normal| {
            let towards_eye = (eye - centre).dot(&normal) >= 0.0;
            if towards_eye { normal } else { -normal }
        });
    }
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
