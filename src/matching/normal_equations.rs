//! The linear equations of one step of an alignment.

use super::estimate::{CORRELATED_POINTS, Observability};
use super::pairing::Pair;
use super::prior::Prior;
use crate::geometry::{Matrix3, Pose2, Transform2, Vector2, Vector3};

/// Root mean square distance of a typical match, metres: what a prior is weighed against.
pub(super) const TYPICAL_RMSE_M: f64 = 0.02;

/// H and −g of ½ Σ w r² for steps (x, y, θ) in the base frame.
#[derive(Default)]
pub(super) struct NormalEquations {
    pub hessian: Matrix3<f64>,
    pub gradient: Vector3<f64>,
    pub weight_sum: f64,
}

/// The sums of [`NormalEquations`], each number once.
#[derive(Default)]
pub(super) struct Sums {
    xx: f64,
    xy: f64,
    yy: f64,
    xt: f64,
    yt: f64,
    tt: f64,
    gradient: [f64; 3],
    weight: f64,
}

impl NormalEquations {
    /// Of pairs at a pose `reference_from_base`. Without a scale all pairs weigh alike; with one,
    /// 1 / (1 + (r/c)²).
    pub(super) fn of(pairs: &[Pair], pose: &Pose2, cauchy_scale_m: Option<f64>) -> Self {
        let to_reference = pose.to_transform();
        let mut sums = Sums::default();
        for pair in pairs {
            sums.add(pair, &to_reference, cauchy_scale_m);
        }
        Self::from(sums)
    }

    /// Of so many times the points: each pair stands for several.
    pub(super) fn stand_for(&mut self, times: usize) {
        let times = times as f64;
        self.hessian *= times;
        self.gradient *= times;
        self.weight_sum *= times;
    }

    /// Pulls towards a prior, in units of one point's variance.
    pub(super) fn add_prior(&mut self, prior: &Prior, pose: &Pose2, range_sigma_m: f64) {
        let offset = prior.pose.between(pose);
        let turned = Pose2::new(0.0, 0.0, offset.theta).rotation();
        let mut jacobian = Matrix3::identity();
        jacobian.fixed_view_mut::<2, 2>(0, 0).copy_from(&turned);
        let variance = noise_variance_m2(range_sigma_m, TYPICAL_RMSE_M) * CORRELATED_POINTS;
        let weighted = jacobian.transpose() * prior.information.matrix() * variance;
        self.hessian += weighted * jacobian;
        self.gradient -= weighted * Vector3::new(offset.x, offset.y, offset.theta);
    }

    /// Keeps of the points only what they say of the directions that they fix.
    pub(super) fn restrict_to(&mut self, observability: &Observability) {
        self.hessian = observability.hessian();
        self.gradient = observability.fixed_part(&self.gradient);
    }

    /// The step −H⁻¹g; none if neither points nor prior fix all directions.
    pub(super) fn solve(&self) -> Vector3<f64> {
        let factor = self.hessian.cholesky();
        factor.map_or(Vector3::zeros(), |factor| factor.solve(&self.gradient))
    }
}

impl From<Sums> for NormalEquations {
    fn from(sums: Sums) -> Self {
        let Sums { xx, xy, yy, .. } = sums;
        let Sums { xt, yt, tt, .. } = sums;
        Self {
            hessian: Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt),
            gradient: Vector3::from(sums.gradient),
            weight_sum: sums.weight,
        }
    }
}

/// Variance of a point's distance to its line, m²: both ends' range noise, or what is seen.
pub(super) fn noise_variance_m2(range_sigma_m: f64, rmse_m: f64) -> f64 {
    (2.0 * range_sigma_m * range_sigma_m).max(rmse_m * rmse_m)
}

/// 1 / (1 + (r/c)²) of a squared distance; 1 without a scale.
#[inline]
pub(super) fn cauchy_weight(squared_m2: f64, scale_m: Option<f64>) -> f64 {
    scale_m.map_or(1.0, |scale_m| {
        scale_m * scale_m / (scale_m * scale_m + squared_m2)
    })
}

impl Sums {
    #[inline]
    fn add(&mut self, pair: &Pair, to_reference: &Transform2, cauchy_scale_m: Option<f64>) {
        let offset = to_reference.apply(&pair.point) - pair.counterpart;
        match pair.normal {
            Some(normal) => {
                let residual_m = normal.dot(&offset);
                let weight = cauchy_weight(residual_m * residual_m, cauchy_scale_m);
                let axis = to_reference.turn_back(&normal);
                self.add_line(&pair.point, &axis, residual_m, weight);
            }
            None => {
                let weight = cauchy_weight(offset.norm_squared(), cauchy_scale_m);
                let offset_in_base = to_reference.turn_back(&offset);
                self.add_corner(&pair.point, &offset_in_base, weight);
            }
        }
    }

    /// A point (base frame) beside a line with a normal `axis` (base frame).
    #[inline]
    pub(super) fn add_line(
        &mut self,
        point: &Vector2<f64>,
        axis: &Vector2<f64>,
        residual_m: f64,
        weight: f64,
    ) {
        self.weight += weight;
        let turn = axis.y * point.x - axis.x * point.y;
        let (x, y, t) = (axis.x * weight, axis.y * weight, turn * weight);
        self.xx += x * axis.x;
        self.xy += x * axis.y;
        self.yy += y * axis.y;
        self.xt += x * turn;
        self.yt += y * turn;
        self.tt += t * turn;
        self.gradient[0] -= x * residual_m;
        self.gradient[1] -= y * residual_m;
        self.gradient[2] -= t * residual_m;
    }

    /// A point (base frame) that lies so far from its counterpart: two axes at right angles, whose
    /// sums do not depend on how they lie.
    pub(super) fn add_corner(
        &mut self,
        point: &Vector2<f64>,
        offset_in_base: &Vector2<f64>,
        weight: f64,
    ) {
        self.weight += weight;
        self.xx += weight;
        self.yy += weight;
        self.xt -= weight * point.y;
        self.yt += weight * point.x;
        self.tt += weight * point.norm_squared();
        self.gradient[0] -= weight * offset_in_base.x;
        self.gradient[1] -= weight * offset_in_base.y;
        self.gradient[2] -= weight * (point.x * offset_in_base.y - point.y * offset_in_base.x);
    }
}
