//! A start without a guess: linear rotations, then linear positions.
//!
//! Rotations are relaxed to complex numbers, Σ κ|u_j − u_i z|² is solved as one linear system and
//! every u is normalised; then F is minimised over the positions alone, which is linear again
//! (Carlone et al., *Initialization techniques for 3D SLAM*, 2015, section III, in the plane).

use nalgebra::{Matrix2, Vector2};

use crate::geometry::{Pose2, wrap_angle};
use crate::solver::factor::Factor;
use crate::solver::least_squares::{DAMPING_MIN, Problem};
use crate::solver::linear::{BlockCholesky, BlockMatrix};

const SIZE: usize = 2;

/// Poses by two linear systems from a problem's factors; held poses stay. `None` if a system
/// could not be solved.
pub(super) fn chordal_poses(problem: &Problem) -> Option<Vec<Pose2>> {
    let mut system = LinearSystem::new(problem)?;
    let mut poses = problem.poses.clone();
    for factor in &problem.factors {
        system.add_rotation(factor, &poses);
    }
    for (k, [re, im]) in system.solve()? {
        poses[k].theta = im.atan2(re);
    }
    system.clear();
    for factor in &problem.factors {
        system.add_position(factor, &poses);
    }
    for (k, [x, y]) in system.solve()? {
        (poses[k].x, poses[k].y) = (x, y);
    }
    poses.iter().all(Pose2::is_finite).then_some(poses)
}

/// A linear least squares problem with two numbers for each pose that is not held.
struct LinearSystem {
    variable: Vec<Option<u32>>,
    /// For each factor its pair; `None` if an end is held.
    pairs: Vec<Option<u32>>,
    matrix: BlockMatrix<SIZE>,
    right_hand_side: Vec<f64>,
    cholesky: BlockCholesky<SIZE>,
    next_factor: usize,
}

impl LinearSystem {
    fn new(problem: &Problem) -> Option<Self> {
        let mut matrix = BlockMatrix::default();
        let mut variable = vec![None; problem.poses.len()];
        for pose in problem.elimination_order()? {
            variable[pose] = Some(matrix.add_variable());
        }
        let pair = |f: &Factor| Some(matrix.add_pair(variable[f.from]?, variable[f.to]?));
        let pairs = problem.factors.iter().map(pair).collect();
        Some(Self {
            variable,
            pairs,
            right_hand_side: vec![0.0; matrix.variables() * SIZE],
            cholesky: BlockCholesky::analyse(&matrix, false),
            matrix,
            next_factor: 0,
        })
    }

    fn clear(&mut self) {
        self.matrix.clear_diagonal();
        self.right_hand_side.fill(0.0);
        self.next_factor = 0;
    }

    /// κ|u_j − u_i z|²: complex multiplication with z is a rotation of the plane.
    fn add_rotation(&mut self, factor: &Factor, poses: &[Pose2]) {
        let weight =
            Matrix2::identity() * (factor.weight * factor.information.matrix()[(2, 2)].max(0.0));
        let held = |k: usize| Vector2::new(poses[k].theta.cos(), poses[k].theta.sin());
        let turn = Pose2::new(0.0, 0.0, factor.measurement.pose.theta).rotation();
        self.add(factor, &weight, -turn, Vector2::zeros(), held);
    }

    /// F with all angles held: e = R(p_j − p_i) − t and a constant in θ.
    fn add_position(&mut self, factor: &Factor, poses: &[Pose2]) {
        let from = poses[factor.from].theta;
        let information = factor.information.matrix() * factor.weight;
        let translation = information.fixed_view::<2, 2>(0, 0).into_owned();
        let cross = information.fixed_view::<2, 1>(0, 2).into_owned();
        let turned = wrap_angle(poses[factor.to].theta - from - factor.measurement.pose.theta);
        let measured = Pose2::new(0.0, 0.0, factor.measurement.pose.theta)
            .rotation()
            .tr_mul(&factor.measurement.pose.translation());
        let map_from_measured =
            Pose2::new(0.0, 0.0, from + factor.measurement.pose.theta).rotation();
        let weight = map_from_measured * translation * map_from_measured.transpose();
        // Completing the square moves the coupling with the angle's error into the target.
        let shift = translation
            .try_inverse()
            .map_or(Vector2::zeros(), |inverse| inverse * cross * turned);
        let target = map_from_measured * (measured - shift);
        let held = |k: usize| poses[k].translation();
        self.add(factor, &weight, -Matrix2::identity(), target, held);
    }

    /// Adds |x_j + A x_i − target|² with a weight.
    fn add(
        &mut self,
        factor: &Factor,
        weight: &Matrix2<f64>,
        a: Matrix2<f64>,
        target: Vector2<f64>,
        held: impl Fn(usize) -> Vector2<f64>,
    ) {
        let pair = self.pairs[self.next_factor];
        self.next_factor += 1;
        let (from, to) = (self.variable[factor.from], self.variable[factor.to]);
        let mut constant = target;
        if from.is_none() {
            constant -= a * held(factor.from);
        }
        if to.is_none() {
            constant -= held(factor.to);
        }
        if let Some(from) = from {
            self.matrix.diagonal[from as usize] += a.tr_mul(&(weight * a));
            self.add_right(from, &a.tr_mul(&(weight * constant)));
        }
        if let Some(to) = to {
            self.matrix.diagonal[to as usize] += weight;
            self.add_right(to, &(weight * constant));
        }
        if let Some(pair) = pair {
            self.matrix.blocks[pair as usize] = a.tr_mul(weight);
        }
    }

    fn add_right(&mut self, variable: u32, part: &Vector2<f64>) {
        let offset = variable as usize * SIZE;
        self.right_hand_side[offset] += part.x;
        self.right_hand_side[offset + 1] += part.y;
    }

    /// The two numbers of each pose that is not held.
    fn solve(&mut self) -> Option<Vec<(usize, [f64; SIZE])>> {
        if !self.cholesky.factorise(&self.matrix, DAMPING_MIN, &mut []) {
            return None;
        }
        self.cholesky.solve(&mut self.right_hand_side);
        let pose_variables = self.variable.iter().enumerate();
        let numbers = pose_variables.filter_map(|(pose, &variable)| {
            let offset = variable? as usize * SIZE;
            let [a, b] = [
                self.right_hand_side[offset],
                self.right_hand_side[offset + 1],
            ];
            Some((pose, [a, b]))
        });
        Some(numbers.collect())
    }
}
