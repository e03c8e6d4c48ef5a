//! An edge's error, and its derivatives for steps in the poses' own frames.
//!
//! A step (a, b, φ) of a pose moves it by (a, b) along its own axes and turns it by φ. The
//! derivatives depend on the poses only through the motion between them: where a whole part of
//! the graph is moved they stay as they are, and so does a factorisation made from them.

use crate::geometry::{Matrix3, Pose2, Vector3, wrap_angle};

/// A pose with its sine and cosine taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) pose: Pose2,
    cos: f64,
    sin: f64,
}

/// An edge's error with its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalError {
    /// As [`Pose2::edge_error`].
    pub(super) error: Vector3<f64>,
    /// ∂e/∂(a, b, φ) of the first pose.
    pub(super) jacobian_from: Matrix3<f64>,
    /// ∂e/∂(a, b, φ) of the second pose.
    pub(super) jacobian_to: Matrix3<f64>,
}

impl Frame {
    #[inline(always)]
    pub(super) fn of(pose: Pose2) -> Self {
        let (sin, cos) = pose.theta.sin_cos();
        Self { pose, cos, sin }
    }

    /// The pose after a step in its own frame.
    #[inline(always)]
    pub(super) fn step(&self, step: &[f64]) -> Pose2 {
        Pose2::new(
            self.pose.x + self.cos * step[0] - self.sin * step[1],
            self.pose.y + self.sin * step[0] + self.cos * step[1],
            self.pose.theta + step[2],
        )
    }

    /// As [`Pose2::edge_error`].
    #[inline(always)]
    pub(super) fn error(from: &Self, to: &Self, measurement: &Self) -> Vector3<f64> {
        let (x, y) = from.see(to);
        measurement.error_of(from, to, x, y)
    }

    /// The place of another pose seen from this one.
    #[inline(always)]
    fn see(&self, other: &Self) -> (f64, f64) {
        let (dx, dy) = (other.pose.x - self.pose.x, other.pose.y - self.pose.y);
        (self.cos * dx + self.sin * dy, self.cos * dy - self.sin * dx)
    }

    #[inline(always)]
    fn error_of(&self, from: &Self, to: &Self, x: f64, y: f64) -> Vector3<f64> {
        let (dx, dy) = (x - self.pose.x, y - self.pose.y);
        let angle = to.pose.theta - from.pose.theta - self.pose.theta;
        Vector3::new(
            self.cos * dx + self.sin * dy,
            self.cos * dy - self.sin * dx,
            wrap_angle(angle),
        )
    }

    /// The error with its derivatives.
    #[inline(always)]
    pub(super) fn local_error(from: &Self, to: &Self, measurement: &Self) -> LocalError {
        let (x, y) = from.see(to);
        let (c, s) = (measurement.cos, measurement.sin);
        let cos_between = from.cos * to.cos + from.sin * to.sin;
        let sin_between = from.cos * to.sin - from.sin * to.cos;
        let cos = cos_between * c + sin_between * s;
        let sin = sin_between * c - cos_between * s;
        LocalError {
            error: measurement.error_of(from, to, x, y),
            jacobian_from: Matrix3::new(
                -c,
                -s,
                c * y - s * x, //
                s,
                -c,
                -s * y - c * x, //
                0.0,
                0.0,
                -1.0,
            ),
            jacobian_to: Matrix3::new(
                cos, -sin, 0.0, //
                sin, cos, 0.0, //
                0.0, 0.0, 1.0,
            ),
        }
    }
}

/// A factor's part of H and g.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quadratic {
    pub(super) from_from: Matrix3<f64>,
    pub(super) from_to: Matrix3<f64>,
    pub(super) to_to: Matrix3<f64>,
    pub(super) gradient_from: Vector3<f64>,
    pub(super) gradient_to: Vector3<f64>,
}

impl LocalError {
    /// JᵀΩJ and JᵀΩe.
    #[inline(always)]
    pub(super) fn quadratic(&self, information: &Matrix3<f64>) -> Quadratic {
        let weighted_error = information * self.error;
        let weighted_to = self.turned_to(information);
        let weighted_from = self.turned_from(information);
        // With a symmetric information JᵀΩJ' = ((ΩJ')ᵀ J)ᵀ, so one product serves both sides.
        Quadratic {
            from_from: self.turned_from(&weighted_from.transpose()),
            from_to: self.turned_from(&weighted_to.transpose()).transpose(),
            to_to: self.turned_to(&weighted_to.transpose()),
            gradient_from: self.jacobian_from.tr_mul(&weighted_error),
            gradient_to: self.jacobian_to.tr_mul(&weighted_error),
        }
    }

    /// A matrix times the second pose's derivatives, without their zeros.
    #[inline(always)]
    fn turned_to(&self, matrix: &Matrix3<f64>) -> Matrix3<f64> {
        let (cos, sin) = (self.jacobian_to[(0, 0)], self.jacobian_to[(1, 0)]);
        let [x, y, angle] = matrix.data.0;
        let mut product = Matrix3::zeros();
        for r in 0..3 {
            product.data.0[0][r] = x[r] * cos + y[r] * sin;
            product.data.0[1][r] = y[r] * cos - x[r] * sin;
        }
        product.data.0[2] = angle;
        product
    }

    /// A matrix times the first pose's derivatives, without their zeros.
    #[inline(always)]
    fn turned_from(&self, matrix: &Matrix3<f64>) -> Matrix3<f64> {
        let (minus_cos, sin) = (self.jacobian_from[(0, 0)], self.jacobian_from[(1, 0)]);
        let (u, v) = (self.jacobian_from[(0, 2)], self.jacobian_from[(1, 2)]);
        let [x, y, angle] = matrix.data.0;
        let mut product = Matrix3::zeros();
        for r in 0..3 {
            product.data.0[0][r] = x[r] * minus_cos + y[r] * sin;
            product.data.0[1][r] = y[r] * minus_cos - x[r] * sin;
            product.data.0[2][r] = x[r] * u + y[r] * v - angle[r];
        }
        product
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-5.0..5.0_f64, -5.0..5.0_f64, -3.1..3.1_f64).prop_map(|(x, y, t)| Pose2::new(x, y, t))
    }

    proptest! {
        #[test]
        fn the_quadratic_is_that_of_the_derivatives(a in pose(), b in pose(), z in pose()) {
            let information = Matrix3::new(4.0, 0.5, -1.0, 0.5, 3.0, 0.25, -1.0, 0.25, 9.0);
            let [a, b, z] = [a, b, z].map(Frame::of);
            let at = Frame::local_error(&a, &b, &z);
            let (from, to) = (at.jacobian_from, at.jacobian_to);
            let quadratic = at.quadratic(&information);
            let expected = [
                (quadratic.from_from, from.transpose() * information * from),
                (quadratic.from_to, from.transpose() * information * to),
                (quadratic.to_to, to.transpose() * information * to),
            ];
            for (got, expected) in expected {
                prop_assert!((got - expected).norm() < 1e-9, "{} {}", got, expected);
            }
            let error = information * at.error;
            prop_assert!((quadratic.gradient_from - from.transpose() * error).norm() < 1e-9);
            prop_assert!((quadratic.gradient_to - to.transpose() * error).norm() < 1e-9);
        }

        #[test]
        fn derivatives_are_those_of_steps(a in pose(), b in pose(), z in pose()) {
            let frames = [a, b, z].map(Frame::of);
            let at = Frame::local_error(&frames[0], &frames[1], &frames[2]);
            let plain = Pose2::edge_error(&a, &b, &z);
            prop_assert!((at.error - plain).norm() < 1e-12 || plain.z.abs() > 3.1);
            const STEP: f64 = 1e-6;
            for k in 0..3 {
                let mut step = [0.0; 3];
                let mut difference = |which: usize| {
                    let ends = [STEP, -STEP].map(|s| {
                        step[k] = s;
                        let mut moved = [a, b];
                        moved[which] = frames[which].step(&step);
                        Pose2::edge_error(&moved[0], &moved[1], &z)
                    });
                    (ends[0] - ends[1]) / (2.0 * STEP)
                };
                for (which, jacobian) in [at.jacobian_from, at.jacobian_to].iter().enumerate() {
                    let numeric = difference(which);
                    // Not where the angle wraps.
                    prop_assert!(
                        numeric.norm() > 100.0 || (numeric - jacobian.column(k)).norm() < 1e-7
                    );
                }
            }
        }
    }
}
