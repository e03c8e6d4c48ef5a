//! The group SE(2).

use nalgebra::{Matrix2, Matrix3, Rotation2, Vector2, Vector3};

use super::wrap_angle;

/// A tangent vector of SE(2): (x, y, θ).
pub type Tangent2 = Vector3<f64>;

/// A rigid motion of the plane: metres, radians, θ in (−π, π].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose2 {
    /// Translation along x, metres.
    pub x: f64,
    /// Translation along y, metres.
    pub y: f64,
    /// Rotation, counter-clockwise, radians.
    pub theta: f64,
}

/// A pose with its sine and cosine taken, for many points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transform2 {
    rotation: Matrix2<f64>,
    translation: Vector2<f64>,
}

impl Transform2 {
    /// A point of the right frame, in the left frame.
    pub fn apply(&self, point: &Vector2<f64>) -> Vector2<f64> {
        self.rotation * point + self.translation
    }

    /// A direction of the right frame, in the left frame.
    pub fn turn(&self, direction: &Vector2<f64>) -> Vector2<f64> {
        self.rotation * direction
    }

    /// A direction of the left frame, in the right frame.
    pub fn turn_back(&self, direction: &Vector2<f64>) -> Vector2<f64> {
        self.rotation.tr_mul(direction)
    }
}

/// An edge's error at two poses, with its derivatives.
#[derive(Debug, Clone, Copy)]
pub struct EdgeError {
    /// e = \[R_zᵀ(R_iᵀ(p_j − p_i) − t_z); wrap(θ_j − θ_i − θ_z)\].
    pub error: Vector3<f64>,
    /// ∂e/∂(x_i, y_i, θ_i), for additive steps of the coordinates.
    pub jacobian_from: Matrix3<f64>,
    /// ∂e/∂(x_j, y_j, θ_j), for additive steps of the coordinates.
    pub jacobian_to: Matrix3<f64>,
}

impl Pose2 {
    /// No motion.
    pub const IDENTITY: Self = Self {
        x: 0.0,
        y: 0.0,
        theta: 0.0,
    };

    /// A pose with its angle wrapped into (−π, π].
    pub fn new(x: f64, y: f64, theta: f64) -> Self {
        Self {
            x,
            y,
            theta: wrap_angle(theta),
        }
    }

    /// The translation, metres.
    pub fn translation(&self) -> Vector2<f64> {
        Vector2::new(self.x, self.y)
    }

    /// Moved by a vector of the frame that it is a pose in, metres; not turned.
    pub fn shifted(&self, by: &Vector2<f64>) -> Self {
        Self {
            x: self.x + by.x,
            y: self.y + by.y,
            ..*self
        }
    }

    /// The rotation as a 2 × 2 matrix.
    pub fn rotation(&self) -> Matrix2<f64> {
        *Rotation2::new(self.theta).matrix()
    }

    /// `self ∘ other`: with `a_from_b` and `b_from_c`, `a_from_c`.
    pub fn compose(&self, other: &Self) -> Self {
        let (sin, cos) = self.theta.sin_cos();
        Self::new(
            self.x + cos * other.x - sin * other.y,
            self.y + sin * other.x + cos * other.y,
            self.theta + other.theta,
        )
    }

    /// With `a_from_b`, `b_from_a`.
    pub fn inverse(&self) -> Self {
        let (sin, cos) = self.theta.sin_cos();
        Self::new(
            -cos * self.x - sin * self.y,
            sin * self.x - cos * self.y,
            -self.theta,
        )
    }

    /// `self⁻¹ ∘ other`: with `map_from_a` and `map_from_b`, `a_from_b`.
    pub fn between(&self, other: &Self) -> Self {
        let (sin, cos) = self.theta.sin_cos();
        let (dx, dy) = (other.x - self.x, other.y - self.y);
        Self::new(
            cos * dx + sin * dy,
            -sin * dx + cos * dy,
            other.theta - self.theta,
        )
    }

    /// A point of the right frame, in the left frame.
    pub fn transform(&self, point: &Vector2<f64>) -> Vector2<f64> {
        let (sin, cos) = self.theta.sin_cos();
        Vector2::new(
            self.x + cos * point.x - sin * point.y,
            self.y + sin * point.x + cos * point.y,
        )
    }

    /// The same motion, made ready for many points.
    pub fn to_transform(&self) -> Transform2 {
        Transform2 {
            rotation: self.rotation(),
            translation: self.translation(),
        }
    }

    /// The group's exponential.
    pub fn exp(tangent: &Tangent2) -> Self {
        let theta = tangent.z;
        let (a, b) = sinc_and_cosc(theta);
        Self::new(
            a * tangent.x - b * tangent.y,
            b * tangent.x + a * tangent.y,
            theta,
        )
    }

    /// The group's logarithm: the inverse of [`Pose2::exp`] for |θ| < π.
    pub fn log(&self) -> Tangent2 {
        let (a, b) = sinc_and_cosc(self.theta);
        let scale = 1.0 / (a * a + b * b);
        Vector3::new(
            scale * (a * self.x + b * self.y),
            scale * (a * self.y - b * self.x),
            self.theta,
        )
    }

    /// The adjoint: T ∘ exp(ξ) = exp(Ad_T ξ) ∘ T.
    pub fn adjoint(&self) -> Matrix3<f64> {
        let (sin, cos) = self.theta.sin_cos();
        Matrix3::new(
            cos, -sin, self.y, //
            sin, cos, -self.x, //
            0.0, 0.0, 1.0,
        )
    }

    /// The pose after an additive step of its coordinates, the angle wrapped.
    pub fn plus(&self, step: &Vector3<f64>) -> Self {
        Self::new(self.x + step.x, self.y + step.y, self.theta + step.z)
    }

    /// The error of a measured motion `measurement` = `i_from_j` at the poses i = `from`, j = `to`.
    pub fn edge_error(from: &Self, to: &Self, measurement: &Self) -> Vector3<f64> {
        let predicted = from.between(to);
        let (sin, cos) = measurement.theta.sin_cos();
        let (dx, dy) = (predicted.x - measurement.x, predicted.y - measurement.y);
        Vector3::new(
            cos * dx + sin * dy,
            -sin * dx + cos * dy,
            wrap_angle(predicted.theta - measurement.theta),
        )
    }

    /// The error of [`Pose2::edge_error`] with its analytic derivatives.
    pub fn edge_error_with_jacobians(from: &Self, to: &Self, measurement: &Self) -> EdgeError {
        let (sin, cos) = (from.theta + measurement.theta).sin_cos();
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        EdgeError {
            error: Self::edge_error(from, to, measurement),
            jacobian_from: Matrix3::new(
                -cos,
                -sin,
                -sin * dx + cos * dy, //
                sin,
                -cos,
                -cos * dx - sin * dy, //
                0.0,
                0.0,
                -1.0,
            ),
            jacobian_to: Matrix3::new(
                cos, sin, 0.0, //
                -sin, cos, 0.0, //
                0.0, 0.0, 1.0,
            ),
        }
    }

    /// Whether all three coordinates are finite.
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.theta.is_finite()
    }
}

/// (sin θ / θ, (1 − cos θ) / θ), by series near zero.
fn sinc_and_cosc(theta: f64) -> (f64, f64) {
    if theta.abs() < 1e-4 {
        let squared = theta * theta;
        (1.0 - squared / 6.0, theta * (0.5 - squared / 24.0))
    } else {
        let (sin, cos) = theta.sin_cos();
        (sin / theta, (1.0 - cos) / theta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    const HARD_ANGLES: [f64; 12] = [
        0.0,
        1e-9,
        -1e-9,
        1e-4,
        -1e-4,
        0.7,
        -0.7,
        2.5,
        -2.5,
        PI - 1e-5,
        1e-5 - PI,
        PI,
    ];

    fn any_pose() -> impl Strategy<Value = Pose2> {
        let angle = prop_oneof![
            (-PI..PI).boxed(),
            proptest::sample::select(HARD_ANGLES.to_vec()).boxed()
        ];
        (-100.0..100.0_f64, -100.0..100.0_f64, angle).prop_map(|(x, y, t)| Pose2::new(x, y, t))
    }

    fn distance(a: &Pose2, b: &Pose2) -> f64 {
        (a.x - b.x)
            .abs()
            .max((a.y - b.y).abs())
            .max(wrap_angle(a.theta - b.theta).abs())
    }

    fn homogeneous(p: &Pose2) -> Matrix3<f64> {
        let (s, c) = p.theta.sin_cos();
        Matrix3::new(c, -s, p.x, s, c, p.y, 0.0, 0.0, 1.0)
    }

    /// exp by its power series on the 3 × 3 matrices: an oracle that shares no code.
    fn exp_by_series(t: &Tangent2) -> Matrix3<f64> {
        let generator = Matrix3::new(0.0, -t.z, t.x, t.z, 0.0, t.y, 0.0, 0.0, 0.0);
        let (mut term, mut sum) = (Matrix3::identity(), Matrix3::identity());
        for k in 1..40 {
            term = term * generator / k as f64;
            sum += term;
        }
        sum
    }

    proptest! {
        #[test]
        fn group_laws(a in any_pose(), b in any_pose(), c in any_pose()) {
            prop_assert!(distance(&a.compose(&b).compose(&c), &a.compose(&b.compose(&c))) < 1e-10);
            prop_assert!(distance(&a.compose(&a.inverse()), &Pose2::IDENTITY) < 1e-10);
            prop_assert!(distance(&a.inverse().compose(&a), &Pose2::IDENTITY) < 1e-10);
            prop_assert!(distance(&a.between(&b), &a.inverse().compose(&b)) < 1e-10);
            let matrix = homogeneous(&a) * homogeneous(&b);
            prop_assert!((homogeneous(&a.compose(&b)) - matrix).norm() < 1e-9);
        }

        #[test]
        fn exp_and_log(a in any_pose(), s in 0.0..1.0_f64) {
            prop_assert!(distance(&Pose2::exp(&a.log()), &a) < 1e-9);
            let half = Pose2::exp(&(a.log() * s)).compose(&Pose2::exp(&(a.log() * (1.0 - s))));
            prop_assert!(distance(&half, &a) < 1e-8);
        }

        #[test]
        fn adjoint_moves_a_tangent_across(a in any_pose(), x in -1.0..1.0_f64, y in -1.0..1.0_f64, t in -1.0..1.0_f64) {
            let tangent = Vector3::new(x, y, t);
            let left = a.compose(&Pose2::exp(&tangent));
            let right = Pose2::exp(&(a.adjoint() * tangent)).compose(&a);
            prop_assert!(distance(&left, &right) < 1e-9);
        }

        #[test]
        fn transform_is_an_action(a in any_pose(), b in any_pose(), x in -50.0..50.0_f64, y in -50.0..50.0_f64) {
            let point = Vector2::new(x, y);
            prop_assert!((a.compose(&b).transform(&point) - a.transform(&b.transform(&point))).norm() < 1e-9);
            let ready = a.to_transform();
            prop_assert!((ready.apply(&point) - a.transform(&point)).norm() < 1e-9);
            prop_assert!((ready.turn_back(&ready.turn(&point)) - point).norm() < 1e-9);
        }

        #[test]
        fn edge_jacobians_agree_with_differences(i in any_pose(), j in any_pose(), noise in any_pose()) {
            let small = Pose2::new(noise.x * 1e-2, noise.y * 1e-2, noise.theta * 0.3);
            let measurement = i.between(&j).compose(&small);
            let exact = Pose2::edge_error_with_jacobians(&i, &j, &measurement);
            let h = 1e-6;
            for k in 0..3 {
                let mut step = Vector3::zeros();
                step[k] = h;
                let from = (Pose2::edge_error(&i.plus(&step), &j, &measurement)
                    - Pose2::edge_error(&i.plus(&-step), &j, &measurement)) / (2.0 * h);
                let to = (Pose2::edge_error(&i, &j.plus(&step), &measurement)
                    - Pose2::edge_error(&i, &j.plus(&-step), &measurement)) / (2.0 * h);
                prop_assert!((exact.jacobian_from.column(k) - from).norm() < 1e-6);
                prop_assert!((exact.jacobian_to.column(k) - to).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn exp_agrees_with_the_power_series_at_hard_angles() {
        for theta in HARD_ANGLES {
            for sign in [1.0, -1.0] {
                let tangent = Vector3::new(1.3, -0.4, sign * theta);
                let difference = homogeneous(&Pose2::exp(&tangent)) - exp_by_series(&tangent);
                assert!(difference.norm() < 1e-11, "θ = {theta}");
            }
        }
    }

    #[test]
    fn a_true_measurement_has_no_error() {
        let (i, j) = (Pose2::new(1.0, 2.0, 3.0), Pose2::new(-4.0, 0.5, -3.0));
        assert!(Pose2::edge_error(&i, &j, &i.between(&j)).norm() < 1e-14);
    }
}
