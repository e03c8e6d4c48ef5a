//! An edge's error, and its derivatives for steps in the poses' own frames.
//!
//! A step (a, b, φ) of a pose moves it by (a, b) along its own axes and turns it by φ. The
//! derivatives depend on the poses only through the motion between them: where a whole part of
//! the graph is moved they stay as they are, and so does a factorisation made from them.

use super::simd::{LANES, dispatch};
use super::trigonometry::{sin_cos, sines_and_cosines, wrap};
use crate::geometry::{Matrix3, Pose2, Vector3};

/// A pose with its sine and cosine taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Frame {
    pub(crate) pose: Pose2,
    pub(crate) cos: f64,
    pub(crate) sin: f64,
}

/// An edge's error with its derivatives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalError {
    /// As [`Pose2::edge_error`].
    pub(crate) error: Vector3<f64>,
    /// ∂e/∂(a, b, φ) of the first pose.
    pub(crate) jacobian_from: Matrix3<f64>,
    /// ∂e/∂(a, b, φ) of the second pose.
    pub(crate) jacobian_to: Matrix3<f64>,
}

impl Frame {
    #[inline(always)]
    pub(crate) fn of(pose: Pose2) -> Self {
        let (sin, cos) = sin_cos(pose.theta);
        Self { pose, cos, sin }
    }

    /// As [`Pose2::edge_error`].
    #[inline(always)]
    pub(crate) fn error(from: &Self, to: &Self, measurement: &Self) -> Vector3<f64> {
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
            wrap(angle),
        )
    }

    /// The error with its derivatives.
    #[inline(always)]
    pub(crate) fn local_error(from: &Self, to: &Self, measurement: &Self) -> LocalError {
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

/// The frames after steps, each in its own frame.
pub(crate) fn take_steps(from: &[Frame], steps: &[[f64; 3]], to: &mut Vec<Frame>) {
    to.clear();
    to.extend_from_slice(from);
    dispatch(
        #[inline(always)]
        || {
            for (frames, steps) in to.chunks_mut(LANES).zip(steps.chunks(LANES)) {
                let mut thetas = [0.0; LANES];
                for (k, (frame, step)) in frames.iter_mut().zip(steps).enumerate() {
                    frame.pose.x += frame.cos * step[0] - frame.sin * step[1];
                    frame.pose.y += frame.sin * step[0] + frame.cos * step[1];
                    thetas[k] = frame.pose.theta + step[2];
                }
                for theta in &mut thetas {
                    *theta = wrap(*theta);
                }
                let (sines, cosines) = sines_and_cosines(thetas);
                for (k, frame) in frames.iter_mut().enumerate() {
                    (frame.sin, frame.cos) = (sines[k], cosines[k]);
                    frame.pose.theta = thetas[k];
                }
            }
        },
    );
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
                        let mut after = Vec::new();
                        take_steps(&frames[which..=which], &[step], &mut after);
                        moved[which] = after[0].pose;
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
