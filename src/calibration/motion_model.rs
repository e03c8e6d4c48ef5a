//! What scans show of a motion by the wheels, seen through a lidar that is not mounted as stated.
//!
//! With C = M_t ∘ M_s⁻¹, of the true and the stated mount, and D the true motion of the base,
//! matching has the motion C⁻¹ ∘ D ∘ C (Censi, Franchi, Marchionni, Oriolo: *Simultaneous
//! calibration of odometry and sensor parameters for mobile robots*, 2013, equation 3, with the
//! lidar's motion carried back to the base by the stated mount).

use nalgebra::{SMatrix, Vector2};

use super::{Corrections, Motions, Quantity, ScanMotion};
use crate::geometry::{Matrix2, Pose2, Tangent2, Vector3};

/// How many unknowns motions have.
pub(super) const UNKNOWNS: usize = Quantity::BY_MOTIONS;
/// Derivatives of an error by the first quantities, in the order of [`Quantity::ALL`].
pub(super) type Jacobian = SMatrix<f64, 3, UNKNOWNS>;

/// Over twice this time the wheels' speed is taken, nanoseconds.
const SPEED_TIME_NS: i64 = 100_000_000;
/// A turn by a quarter.
const QUARTER: Matrix2<f64> = Matrix2::new(0.0, -1.0, 1.0, 0.0);

/// The motion of the base by scans that follows from a true one: C⁻¹ ∘ D ∘ C.
pub(super) fn seen(stated_mount: &Pose2, corrections: &Corrections, motion: &Pose2) -> Pose2 {
    let shift = corrections
        .mount(stated_mount)
        .compose(&stated_mount.inverse());
    shift.inverse().compose(motion).compose(&shift)
}

/// What each second of clock offset changes of a motion by the wheels: their speed where it begins
/// less the one where it ends, metres and radians a second. `None` without odometry.
pub(super) fn change_of_speed(
    motions: &Motions,
    motion: &ScanMotion,
    offset_ns: i64,
) -> Option<Tangent2> {
    let later = motions.by_wheels(motion, offset_ns + SPEED_TIME_NS)?.log();
    let sooner = motions.by_wheels(motion, offset_ns - SPEED_TIME_NS)?.log();
    Some((later - sooner) / (2e-9 * SPEED_TIME_NS as f64))
}

/// The error of a motion by scans, \[R_zᵀ(p − t_z); wrap(θ − θ_z)\] for p, θ as [`seen`] has them,
/// with its derivatives. `None` without odometry.
pub(super) fn error_with_jacobian(
    motions: &Motions,
    motion: &ScanMotion,
    corrections: &Corrections,
) -> Option<(Vector3<f64>, Jacobian)> {
    let offset_ns = corrections.clock_offset_ns();
    let by_wheels = motions.by_wheels(motion, offset_ns)?.log();
    let by_offset = change_of_speed(motions, motion, offset_ns)?;

    let driven = corrections.twist(&by_wheels);
    let turned = Pose2::exp(&driven);
    let predicted = seen(motions.mount(), corrections, &turned);
    let error = Pose2::edge_error(&Pose2::IDENTITY, &predicted, &motion.motion);

    let yaw_rad = corrections.get(Quantity::MountYaw);
    let back = rotation(-yaw_rad);
    let stated = motions.mount().translation();
    let true_mount = corrections.mount(motions.mount()).translation();
    let arm = true_mount - rotation(yaw_rad) * stated;
    let swing = rotation(driven.z) - Matrix2::identity();
    let arm_by_yaw = -(QUARTER * rotation(yaw_rad) * stated);
    // By the mount.
    let by_yaw = -(QUARTER * predicted.translation()) + back * swing * arm_by_yaw;
    let by_place = back * swing;
    // By the twist (x, y, θ) of the base.
    let (arc, arc_by_turn) = arc_matrices(driven.z);
    let by_way = back * arc;
    let by_turn = back * (QUARTER * rotation(driven.z) * arm + arc_by_turn * driven.xy());
    let by_twist = |twist: Tangent2| -> Vector3<f64> {
        let shift = by_way * twist.xy() + by_turn * twist.z;
        Vector3::new(shift.x, shift.y, twist.z)
    };
    let no_turn = |shift: Vector2<f64>| Vector3::new(shift.x, shift.y, 0.0);
    let columns = [
        no_turn(by_yaw),
        no_turn(by_place.column(0).into()),
        no_turn(by_place.column(1).into()),
        by_twist(Vector3::new(by_wheels.x, by_wheels.y, 0.0)),
        by_twist(Vector3::new(0.0, 0.0, by_wheels.z)),
        by_twist(Vector3::new(0.0, 0.0, by_wheels.x)),
        by_twist(corrections.twist(&by_offset)),
    ];
    let to_measured = rotation(-motion.motion.theta);
    let in_measured = |column: Vector3<f64>| {
        let shift = to_measured * column.xy();
        Vector3::new(shift.x, shift.y, column.z)
    };
    Some((error, Jacobian::from_columns(&columns.map(in_measured))))
}

fn rotation(angle_rad: f64) -> Matrix2<f64> {
    Pose2::new(0.0, 0.0, angle_rad).rotation()
}

/// V of the exponential's translation V(θ)·v, and its derivative by θ.
fn arc_matrices(turn_rad: f64) -> (Matrix2<f64>, Matrix2<f64>) {
    let (sin, cos) = turn_rad.sin_cos();
    let (a, b, a_by_turn, b_by_turn) = if turn_rad.abs() < 1e-3 {
        let squared = turn_rad * turn_rad;
        let (a, b) = (1.0 - squared / 6.0, 0.5 * turn_rad);
        (a, b, -turn_rad / 3.0, 0.5 - squared / 8.0)
    } else {
        let (a, b) = (sin / turn_rad, (1.0 - cos) / turn_rad);
        (a, b, (cos - a) / turn_rad, (sin - b) / turn_rad)
    };
    let matrix = |a: f64, b: f64| Matrix2::new(a, -b, b, a);
    (matrix(a, b), matrix(a_by_turn, b_by_turn))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::calibration::OdometryTrack;
    use crate::calibration::testing::weaving;
    use crate::geometry::Information;
    use crate::ids::StampNs;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn derivatives_are_those_of_differences(
            values in prop::array::uniform7(-0.1..0.1_f64), at_s in 2.0..6.0_f64,
            x in -0.5..0.5_f64, mount_rad in -3.0..3.0_f64,
        ) {
            let stamp = |seconds: f64| StampNs((1e9 * seconds) as i64);
            let track = OdometryTrack::through((0..1000).map(|k| {
                let seconds = 0.01 * f64::from(k);
                (stamp(seconds), weaving(seconds))
            }));
            let motion = ScanMotion {
                from: stamp(at_s),
                to: stamp(at_s + 0.7),
                motion: weaving(at_s).between(&weaving(at_s + 0.7)),
                information: Information::identity(),
            };
            let motions = Motions::new(Pose2::new(x, 0.2, mount_rad), track, [motion]);
            let mut corrections = Corrections::default();
            for (quantity, value) in Quantity::ALL.into_iter().zip(values) {
                corrections.set(quantity, value);
            }
            let (error, jacobian) = error_with_jacobian(&motions, &motion, &corrections).unwrap();
            for (k, quantity) in Quantity::ALL.into_iter().take(UNKNOWNS).enumerate() {
                let step = if quantity == Quantity::ClockOffset { 0.1 } else { 1e-5 };
                let at = |by: f64| {
                    let moved = corrections.with(quantity, corrections.get(quantity) + by);
                    error_with_jacobian(&motions, &motion, &moved).unwrap().0
                };
                let difference = (at(step) - at(-step)) / (2.0 * step);
                let off = (difference - jacobian.column(k)).norm();
                let close = if quantity == Quantity::ClockOffset { 2e-3 } else { 1e-6 };
                prop_assert!(off < close, "{:?}: {} of {}", quantity, off, difference.norm());
            }
            let offset_ns = corrections.clock_offset_ns();
            let by_wheels = motions.by_wheels(&motion, offset_ns).unwrap();
            let driven = corrections.motion(&by_wheels);
            let predicted = seen(motions.mount(), &corrections, &driven);
            let direct = Pose2::edge_error(&Pose2::IDENTITY, &predicted, &motion.motion);
            prop_assert!((error - direct).norm() < 1e-12);
        }
    }
}
