//! The last steps of an alignment: what it ends at does not hang on single points.
//!
//! A point's nearest neighbour changes from one to the next while a scan moves, and the line that
//! it is compared with jumps. So the same two scans with a millimetre of noise ended at other
//! places. Here a point is compared with the surface that all points around it describe, the mean
//! of their lines, weighed by distance: implicit moving least squares (Kolluri, *Provably good
//! moving least squares*, 2008; on lidar scans Deschaud, *IMLS-SLAM*, 2018).

use super::cloud::ReferenceCloud;
use super::normal_equations::{NormalEquations, Sums, cauchy_weight};
use crate::geometry::{Pose2, Transform2, Vector2};
use crate::scan::SurfacePoint;

/// Points of the reference count within this distance, metres, …
const REACH_M: f64 = 0.09;
/// … and within this share of the range more: beams lie farther apart there.
const REACH_PER_RANGE: f64 = 0.015;
/// Neighbours are found anew when points may have moved by this, metres.
const SPARE_M: f64 = 0.03;
/// So many points say as much as all (at least so many, and fewer than twice as many, are asked).
const POINTS: usize = 360;
/// Lines turned away by more than this cosine are another surface's …
const COSINE_MIN: f64 = 0.6;
/// … and a point without a normal might be turned away so much.
const COSINE_UNKNOWN: f64 = 0.85;
/// Fewer points around count less.
const WEIGHT_FULL: f64 = 0.3;
/// An alignment is not based on fewer points than these.
pub(super) const WEIGHT_SUM_MIN: f64 = 6.0;

/// The points of a scan, each with the reference's points around it.
pub(super) struct Surroundings<'a> {
    reference: &'a ReferenceCloud,
    asked: Vec<Asked<'a>>,
    /// Of all asked points, one after the other.
    neighbours: Vec<u32>,
    stride: usize,
}

struct Asked<'a> {
    point: &'a SurfacePoint,
    reach_m: f64,
    /// Where its neighbours end.
    end: usize,
}

impl<'a> Surroundings<'a> {
    /// Of points at a pose `reference_from_base`, or a little beside it.
    pub(super) fn at(
        pose: &Pose2,
        reference: &'a ReferenceCloud,
        points: &'a [SurfacePoint],
    ) -> Self {
        let to_reference = pose.to_transform();
        let stride = (points.len() / POINTS).max(1);
        let mut surroundings = Self {
            reference,
            asked: Vec::with_capacity(points.len() / stride + 1),
            neighbours: Vec::new(),
            stride,
        };
        for point in points.iter().step_by(stride) {
            let reach_m = REACH_M + REACH_PER_RANGE * point.range_m;
            let position = to_reference.apply(&point.position);
            reference.around(&position, reach_m + SPARE_M, |k| {
                surroundings.neighbours.push(k as u32);
            });
            surroundings.asked.push(Asked {
                point,
                reach_m,
                end: surroundings.neighbours.len(),
            });
        }
        surroundings
    }

    /// Whether the points are still where their neighbours were found, after a motion.
    pub(super) fn cover(&self, moved_m: f64) -> bool {
        moved_m <= SPARE_M
    }

    /// The equations at a pose near that one.
    pub(super) fn equations(&self, pose: &Pose2, cauchy_scale_m: Option<f64>) -> NormalEquations {
        let to_reference = pose.to_transform();
        let mut sums = Sums::default();
        let mut start = 0;
        for asked in &self.asked {
            let around = &self.neighbours[start..asked.end];
            start = asked.end;
            let surface = MeanSurface::of(asked, around, self.reference, &to_reference);
            surface.add_to(&mut sums, asked.point, &to_reference, cauchy_scale_m);
        }
        let mut equations = NormalEquations::from(sums);
        equations.stand_for(self.stride);
        equations
    }
}

/// What the reference's points around a position describe.
#[derive(Debug, Default)]
struct MeanSurface {
    /// Of points with a line: their weights, …
    lines: f64,
    /// … their weighted distances from the position, metres, …
    distance_m: f64,
    /// … and their weighted normals.
    normal: Vector2<f64>,
    /// Of points without: their weights …
    corners: f64,
    /// … and their weighted offsets to the position, metres.
    offset: Vector2<f64>,
}

impl MeanSurface {
    fn of(
        asked: &Asked<'_>,
        around: &[u32],
        reference: &ReferenceCloud,
        to_reference: &Transform2,
    ) -> Self {
        let position = to_reference.apply(&asked.point.position);
        let own_normal = asked.point.normal.map(|n| to_reference.turn(&n));
        let per_m2 = 1.0 / (asked.reach_m * asked.reach_m);
        let mut surface = Self::default();
        for &k in around {
            let offset = position - reference.position(k as usize);
            let nearness = 1.0 - offset.norm_squared() * per_m2;
            if nearness <= 0.0 {
                continue;
            }
            let weight = nearness * nearness * nearness;
            match reference.normal(k as usize) {
                Some(normal) => {
                    let cosine = own_normal.map_or(COSINE_UNKNOWN, |own| own.dot(&normal));
                    let facing = ((cosine - COSINE_MIN) / (1.0 - COSINE_MIN)).clamp(0.0, 1.0);
                    let weight = weight * facing;
                    surface.lines += weight;
                    surface.distance_m += weight * normal.dot(&offset);
                    surface.normal += weight * normal;
                }
                None => {
                    surface.corners += weight;
                    surface.offset += weight * offset;
                }
            }
        }
        surface
    }

    /// Adds what a point says that is compared with it.
    fn add_to(
        &self,
        sums: &mut Sums,
        point: &SurfacePoint,
        to_reference: &Transform2,
        cauchy_scale_m: Option<f64>,
    ) {
        let total = self.lines + self.corners;
        let share = (total / WEIGHT_FULL).min(1.0) / total;
        let length = self.normal.norm();
        if self.lines > 0.0 && length > 0.0 {
            let axis = to_reference.turn_back(&(self.normal / length));
            let residual_m = self.distance_m / length;
            let weight = share * self.lines * cauchy_weight(residual_m.powi(2), cauchy_scale_m);
            sums.add_line(&point.position, &axis, residual_m, weight);
        }
        if self.corners > 0.0 {
            let offset = self.offset / self.corners;
            let weight =
                share * self.corners * cauchy_weight(offset.norm_squared(), cauchy_scale_m);
            sums.add_corner(&point.position, &to_reference.turn_back(&offset), weight);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::testing::look;
    use crate::matching::{IcpParams, align};
    use crate::sim::Hall;

    type PlacedPoints = (Pose2, Vec<SurfacePoint>);

    /// The scans of a few places along a hall's route, and one a little farther on.
    fn views(at_m: f64, seed: u64) -> (Vec<PlacedPoints>, PlacedPoints) {
        let hall = Hall::generate(17).unwrap();
        let first = hall.route.pose_at(at_m);
        let seen_from = |k: u32| {
            let pose = hall.route.pose_at(at_m + 0.5 * f64::from(k));
            (first.between(&pose), look(&hall.world, &pose, seed))
        };
        ((0..4).map(seen_from).collect(), seen_from(4))
    }

    fn cloud_of(scans: &[PlacedPoints]) -> ReferenceCloud {
        let scans = scans
            .iter()
            .map(|(pose, points)| (*pose, points.as_slice()));
        ReferenceCloud::new(scans).unwrap()
    }

    #[test]
    fn a_millimetre_of_noise_turns_a_smooth_end_less() {
        let turned_rad = |params: &IcpParams| {
            let turns = (0..40).map(|k| {
                let ends = [0, k + 1].map(|seed| {
                    let (scans, (pose, points)) = views(1.7 * k as f64, seed);
                    let start = pose.compose(&Pose2::new(0.05, -0.03, 0.02));
                    align(&cloud_of(&scans), &points, &start, 0.01, None, params).pose
                });
                ends[0].between(&ends[1]).theta.powi(2)
            });
            (turns.sum::<f64>() / 40.0).sqrt()
        };
        let nearest = IcpParams {
            ends_smoothly: false,
            ..IcpParams::ROBUST
        };
        let (smooth, nearest) = (turned_rad(&IcpParams::ROBUST), turned_rad(&nearest));
        assert!(smooth < 0.5 * nearest, "{smooth} rad, {nearest} rad");
    }

    #[test]
    fn equations_do_not_jump() {
        let (scans, (pose, points)) = views(20.0, 0);
        let cloud = cloud_of(&scans);
        let surroundings = Surroundings::at(&pose, &cloud, &points);
        let at = |k: u32| {
            let moved_m = 1e-6 * f64::from(k);
            let beside = pose.compose(&Pose2::new(moved_m, 0.5 * moved_m, 0.3 * moved_m));
            surroundings.equations(&beside, Some(0.03))
        };
        for k in 0..2_000 {
            let (here, there) = (at(k), at(k + 1));
            let step = (there.gradient - here.gradient).norm();
            // A few times what the equations say of a step of a micrometre.
            assert!(step < 1e-5 * here.hessian.norm(), "{k}: {step}");
        }
    }

    #[test]
    fn a_surface_is_the_mean_of_the_lines_around() {
        let wall = |y: f64| -> Vec<SurfacePoint> {
            let point = |k: u32| SurfacePoint {
                position: Vector2::new(0.02 * f64::from(k), y),
                normal: Some(Vector2::new(0.0, -1.0)),
                beam: k as usize,
                range_m: 2.0,
            };
            (0..200).map(point).collect()
        };
        // The wall is drawn twice, four centimetres apart: it lies between.
        let (low, high) = (wall(1.98), wall(2.02));
        let reference = [low, high].map(|points| (Pose2::IDENTITY, points));
        let point = [SurfacePoint {
            position: Vector2::new(2.0, 2.0),
            normal: Some(Vector2::new(0.0, -1.0)),
            beam: 0,
            range_m: 2.0,
        }];
        let cloud = cloud_of(&reference);
        let at = |y: f64| {
            let pose = Pose2::new(0.0, y, 0.0);
            Surroundings::at(&pose, &cloud, &point).equations(&pose, None)
        };
        assert!(at(0.0).gradient.norm() < 1e-9, "{}", at(0.0).gradient);
        assert!((at(0.0).weight_sum - 1.0).abs() < 1e-9);
        let pulled = at(0.01).gradient;
        assert!(pulled.y < -0.002 && pulled.x.abs() < 1e-9, "{pulled}");
        assert_eq!(at(1.0).weight_sum, 0.0, "nothing is around");
    }
}
