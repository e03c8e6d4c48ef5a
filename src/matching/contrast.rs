//! How well a match is told from those beside it.
//!
//! Along a corridor the lines of the walls fix nothing, but noise in their normals looks as if they
//! did, and wherever a match begins it stays. What the points say along the direction that they fix
//! least is therefore asked of the points themselves: how much worse they fit a hand to either
//! side.

use super::icp::Alignment;
use super::icp_params::IcpParams;
use super::normal_equations::{NormalEquations, cauchy_weight};
use crate::geometry::{Information, Pose2, Vector2, Vector3};

/// Where the points weigh along their weakest direction at least this share of what they weigh in
/// all, nothing need be asked.
const WEIGHT_SHARE_STRONG: f64 = 0.2;
/// What a step of a vehicle is compared with, whose wheels say about where it ends: metres along the
/// weakest direction.
pub const BESIDE_A_STEP_M: &[f64] = &[-0.3, -0.15, 0.15, 0.3];
/// What a place on the map is compared with: door frames are alike, and the next one may fit too.
pub const BESIDE_A_PLACE_M: &[f64] = &[-0.8, -0.6, -0.45, -0.3, -0.15, 0.15, 0.3, 0.45, 0.6, 0.8];
/// A point as far off its counterpart's line as this fits half, metres; …
const FIT_SCALE_M: f64 = 0.05;
/// … and one with a counterpart no nearer than this not at all.
const FIT_GATE_M: f64 = 0.3;
/// So many points say as much as all.
const FIT_POINTS: usize = 180;
/// Poses along the weakest direction are tried so far apart, metres.
const ALONG_STEP_M: f64 = 0.1;
/// If so much more of the scan fits than beside it, the direction is fixed, …
const GAIN_SURE: f64 = 0.03;
/// … and if no more than this does, it is not.
const GAIN_NONE: f64 = 0.005;

/// The direction of motion that points fix least, and how far they fix it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contrast {
    /// Unit vector, base frame.
    pub axis: Vector2<f64>,
    /// 0 where the points fit as well beside, 1 where they plainly do not.
    pub fixed_share: f64,
}

impl Contrast {
    /// The information of an estimate, less what the points only seem to say.
    pub fn held_to(&self, information: &Information) -> Information {
        let direction = Vector3::new(self.axis.x, self.axis.y, 0.0);
        information.with_share_along(&direction, self.fixed_share)
    }
}

impl Alignment<'_> {
    /// Of the scan at a pose `reference_from_base` that it was aligned to, compared with poses
    /// beside it: metres along the direction that the points fix least.
    pub fn contrast(&mut self, pose: &Pose2, params: &IcpParams, beside_m: &[f64]) -> Contrast {
        self.pairing.look_up(pose, params.gate_end_m, params, 1);
        let equations = NormalEquations::of(self.pairing.pairs(), pose, params.cauchy_scale_m);
        let xy = equations.hessian.fixed_view::<2, 2>(0, 0).into_owned();
        let eigen = xy.symmetric_eigen();
        let weakest = eigen.eigenvalues.imin();
        let axis = eigen.eigenvectors.column(weakest).into_owned();
        if eigen.eigenvalues[weakest] >= WEIGHT_SHARE_STRONG * equations.weight_sum {
            let fixed_share = 1.0;
            return Contrast { axis, fixed_share };
        }
        let mut fit_at = |along_m: f64| {
            let beside = Pose2::new(along_m * axis.x, along_m * axis.y, 0.0);
            self.fit(&pose.compose(&beside), params)
        };
        let here = fit_at(0.0);
        let beside = beside_m.iter().map(|along_m| fit_at(*along_m));
        let gain = here - beside.fold(0.0, f64::max);
        Contrast {
            axis,
            fixed_share: ((gain - GAIN_NONE) / (GAIN_SURE - GAIN_NONE)).clamp(0.0, 1.0),
        }
    }

    /// Where along an axis (unit vector, base frame), no farther from `pose` than `within_m`, the
    /// scan fits best, in steps of 0.1 m; `pose` itself if nowhere plainly better.
    pub fn best_along(
        &mut self,
        pose: &Pose2,
        axis: &Vector2<f64>,
        within_m: f64,
        params: &IcpParams,
    ) -> Pose2 {
        let steps = (within_m / ALONG_STEP_M).floor() as i32;
        let mut best = (self.fit(pose, params) + GAIN_SURE, *pose);
        for step in (-steps..=steps).filter(|step| *step != 0) {
            let along_m = f64::from(step) * ALONG_STEP_M;
            let tried = pose.compose(&Pose2::new(along_m * axis.x, along_m * axis.y, 0.0));
            let fit = self.fit(&tried, params);
            if fit > best.0 {
                best = (fit, tried);
            }
        }
        best.1
    }

    /// The share of the scan that fits at a pose.
    fn fit(&mut self, pose: &Pose2, params: &IcpParams) -> f64 {
        let points = self.pairing.points().len();
        let stride = (points / FIT_POINTS).max(1);
        self.pairing.look_up(pose, FIT_GATE_M, params, stride);
        let to_reference = pose.to_transform();
        let within = self.pairing.pairs().iter();
        let fits = within.map(|pair| {
            let offset = to_reference.apply(&pair.point) - pair.counterpart;
            let off_m2 = pair
                .normal
                .map_or(offset.norm_squared(), |n| n.dot(&offset).powi(2));
            cauchy_weight(off_m2, Some(FIT_SCALE_M))
        });
        fits.sum::<f64>() / points.div_ceil(stride).max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::ReferenceCloud;
    use crate::matching::testing::look;
    use crate::sim::{Shape, World};

    /// Walls to the left and to the right, 60 m long, and pillars along them.
    fn corridor(pillars: &[f64]) -> World {
        let wall = |y: f64| Shape::rectangle(&Pose2::new(0.0, y, 0.0), 60.0, 0.2);
        let pillar = |x: &f64| Shape::rectangle(&Pose2::new(*x, 1.0, 0.0), 0.4, 0.4);
        let pillars: Vec<Shape> = pillars.iter().map(pillar).collect();
        World::new([wall(-1.2), wall(1.2)].into_iter().chain(pillars))
    }

    fn contrast_in(world: &World) -> Contrast {
        let moved = Pose2::new(0.4, 0.05, 0.02);
        let old = look(world, &Pose2::IDENTITY, 0);
        let new = look(world, &moved, 3);
        let cloud = ReferenceCloud::new([(Pose2::IDENTITY, old.as_slice())]).unwrap();
        Alignment::new(&cloud, &new).contrast(&moved, &IcpParams::ROBUST, BESIDE_A_PLACE_M)
    }

    #[test]
    fn a_corridor_is_not_fixed_along_it() {
        let bare = contrast_in(&corridor(&[]));
        assert_eq!(bare.fixed_share, 0.0);
        assert!(bare.axis.x.abs() > 0.99, "{}", bare.axis);
    }

    #[test]
    fn what_stands_in_a_corridor_fixes_it() {
        let pillars = contrast_in(&corridor(&[-3.0, 1.5, 4.0]));
        assert_eq!(pillars.fixed_share, 1.0);
        assert!(pillars.axis.x.abs() > 0.99, "{}", pillars.axis);
    }

    #[test]
    fn an_estimate_keeps_what_is_fixed() {
        let sure = Information::from_sigmas(0.01, 0.002);
        let along = |fixed_share| {
            let axis = Vector2::new(1.0, 0.0);
            Contrast { axis, fixed_share }.held_to(&sure)
        };
        assert_eq!(along(1.0), sure);
        let none = along(0.0).squared_norm(&Vector3::new(1.0, 0.0, 0.0));
        assert!(none < 1e-9, "{none}");
        let across = Vector3::new(0.0, 1.0, 1.0);
        assert_eq!(along(0.0).squared_norm(&across), sure.squared_norm(&across));
    }

    #[test]
    fn a_room_is_fixed_in_every_direction() {
        let room = [Vector2::new(-3.0, -2.0), Vector2::new(3.0, -2.0)];
        let far = [Vector2::new(3.0, 2.0), Vector2::new(-3.0, 2.0)];
        let walls = Shape::Outline(room.into_iter().chain(far).collect());
        assert_eq!(contrast_in(&World::new([walls])).fixed_share, 1.0);
    }
}
