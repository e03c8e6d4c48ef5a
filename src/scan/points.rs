//! A scan's end points with the normals of the surfaces they lie on.

use super::{LaserScan, Lidar};
use crate::geometry::Vector2;

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
    let to_base = lidar.mount.to_transform();
    let mut points: Vec<SurfacePoint> = Vec::with_capacity(scan.return_count());
    for (beam, direction) in lidar.beam_directions(scan.beam_count()).enumerate() {
        let Some(range_m) = scan.range_m(beam) else {
            continue;
        };
        points.push(SurfacePoint {
            position: to_base.apply(&(range_m * direction)),
            normal: None,
            beam,
            range_m,
        });
    }
    let gaps_m2: Vec<f64> = points.windows(2).map(gap_m2).collect();
    let eye = lidar.mount.translation();
    for k in 0..points.len() {
        points[k].normal = line_normal(&points, &gaps_m2, k, lidar, &eye);
    }
    points
}

/// Square of the distance between two neighbouring returns; no surface joins those of beams that
/// are no neighbours.
fn gap_m2(pair: &[SurfacePoint]) -> f64 {
    if pair[1].beam - pair[0].beam <= 2 {
        (pair[1].position - pair[0].position).norm_squared()
    } else {
        f64::INFINITY
    }
}

fn line_normal(
    points: &[SurfacePoint],
    gaps_m2: &[f64],
    k: usize,
    lidar: &Lidar,
    eye: &Vector2<f64>,
) -> Option<Vector2<f64>> {
    let centre = &points[k];
    let gap_m = (GAP_SPACINGS * lidar.angle_increment_rad * centre.range_m).max(GAP_MIN_M);
    let reach_m = LINE_REACH_SIGMAS * lidar.range_sigma_m;
    let mut scatter = Scatter::default();
    let mut take = |neighbours: usize, gap_to_it_m2: f64, point: &SurfacePoint| {
        let offset = point.position - centre.position;
        let within_reach = neighbours < NEIGHBOURS_MIN
            || neighbours < NEIGHBOURS_MAX && offset.norm_squared() <= reach_m * reach_m;
        let takes = within_reach && gap_to_it_m2 <= gap_m * gap_m;
        if takes {
            scatter.add(&offset);
        }
        takes
    };
    for (neighbours, j) in (0..k).rev().enumerate() {
        if !take(neighbours, gaps_m2[j], &points[j]) {
            break;
        }
    }
    for (neighbours, j) in (k + 1..points.len()).enumerate() {
        if !take(neighbours, gaps_m2[j - 1], &points[j]) {
            break;
        }
    }
    let normal = scatter.normal()?;
    let towards_eye = (eye - centre.position).dot(&normal) >= 0.0;
    Some(if towards_eye { normal } else { -normal })
}

/// How a point and its neighbours lie around their middle.
#[derive(Default)]
struct Scatter {
    neighbours: usize,
    /// Of offsets from the point, metres.
    sum: Vector2<f64>,
    /// Of their products, m².
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Scatter {
    fn add(&mut self, offset: &Vector2<f64>) {
        self.neighbours += 1;
        self.sum += offset;
        self.xx += offset.x * offset.x;
        self.xy += offset.x * offset.y;
        self.yy += offset.y * offset.y;
    }

    /// The unit vector along which there is least of it; `None` where that is no line.
    fn normal(&self) -> Option<Vector2<f64>> {
        if self.neighbours + 1 < LINE_POINTS_MIN {
            return None;
        }
        let mean = self.sum / (self.neighbours + 1) as f64;
        let half_trace = 0.5 * (self.xx - self.sum.x * mean.x + self.yy - self.sum.y * mean.y);
        let half_difference = 0.5 * (self.xx - self.sum.x * mean.x - self.yy + self.sum.y * mean.y);
        let product = self.xy - self.sum.x * mean.y;
        let radius = (half_difference * half_difference + product * product).sqrt();
        let (across, along) = (half_trace - radius, half_trace + radius);
        if radius <= 0.0 || across > LINE_FLATNESS_MAX * LINE_FLATNESS_MAX * along {
            return None;
        }
        // The line's direction is half the angle of (half_difference, product).
        let line = if half_difference >= 0.0 {
            Vector2::new(radius + half_difference, product)
        } else {
            Vector2::new(product, radius - half_difference)
        };
        let line = line.normalize();
        Some(Vector2::new(-line.y, line.x))
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
            band: None,
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
            band: None,
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
                band: None,
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
