//! Attribution of ΔF: the increase of F by each of several new closures, from one solve with all of
//! them.
//!
//! At the optimum with all of them, F without the last few is less by rᵀ(Ω⁻¹ − J H⁻¹ Jᵀ)⁻¹ r, where
//! r are their errors there, J their derivatives, Ω their information, and H that of the whole
//! problem (exact where errors are linear). An elimination from the last closure to the first gives
//! each one's part. The first closure gets what is left of the increase as measured: it may be all
//! that ties a node, and then its part is the rest.

use nalgebra::{DMatrix, DVector, Matrix3};

use crate::solver::factor::{Frame, square_root};
use crate::solver::least_squares::{NormalEquations, POSE_SIZE, Problem};

/// A direction whose redundancy (the part of it that would be known without a closure) is below
/// this is known by that closure alone, and its error there is zero.
const REDUNDANCY_MIN: f64 = 1e-6;

/// Attributes the increase of F to new factors, given by their names in the order in which they
/// came; the equations must be those of the problem, factored near its poses. If there are
/// none, the first factor gets it all.
pub(super) fn attribute_increase(
    increase: f64,
    new: &[usize],
    problem: &Problem,
    equations: Option<&mut NormalEquations>,
) -> Vec<f64> {
    let mut attributed = vec![0.0; new.len()];
    let Some((first, later)) = attributed.split_first_mut() else {
        return attributed;
    };
    let of_later = equations.and_then(|e| increases_of_later(&new[1..], problem, e));
    let of_later = of_later.unwrap_or_default();
    for (own, increase) in later.iter_mut().zip(of_later) {
        *own = increase;
    }
    let mut sum: f64 = later.iter().sum();
    let increase_max = increase.max(0.0);
    if sum > increase_max {
        // The errors are not so linear.
        let part = increase_max / sum;
        later.iter_mut().for_each(|own| *own *= part);
        sum *= part;
    }
    *first = increase - sum;
    attributed
}

fn increases_of_later(
    later: &[usize],
    problem: &Problem,
    equations: &mut NormalEquations,
) -> Option<Vec<f64>> {
    if later.is_empty() {
        return None;
    }
    let size = later.len() * POSE_SIZE;
    let mut errors = DVector::zeros(size);
    let mut columns = Vec::with_capacity(size);
    let frame = |pose: usize| Frame::of(problem.poses[pose]);
    for (k, name) in later.iter().rev().enumerate() {
        // What is new stands last.
        let position = problem.factor_names.iter().rposition(|other| other == name);
        let factor = &problem.factors[position?];
        let ends = [factor.from, factor.to];
        let at = Frame::local_error(&frame(ends[0]), &frame(ends[1]), &factor.measurement);
        let (root, _) = square_root(&factor.information);
        errors
            .fixed_rows_mut::<POSE_SIZE>(k * POSE_SIZE)
            .copy_from(&(root * at.error));
        let whitened = [at.jacobian_from, at.jacobian_to].map(|j| j.tr_mul(&root));
        for axis in 0..POSE_SIZE {
            let part = |matrix: &Matrix3<f64>| matrix.column(axis).into_owned();
            columns.push([(ends[0], part(&whitened[0])), (ends[1], part(&whitened[1]))]);
        }
    }
    let solved = equations.solve_lower(&columns);
    let rows = solved.len() / size;
    let solved = DMatrix::from_vec(rows, size, solved);
    let redundancy = DMatrix::identity(size, size) - solved.tr_mul(&solved);
    let parts = eliminate(redundancy, errors);
    let increases = parts.as_slice().chunks_exact(POSE_SIZE).rev();
    let increases: Vec<f64> = increases.map(|part| part.iter().sum()).collect();
    let are_finite = increases.iter().all(|increase| increase.is_finite());
    are_finite.then_some(increases)
}

/// What each entry of r adds to rᵀ M⁻¹ r once those before it are there: the squares of L⁻¹ r over
/// the pivots of M = L D Lᵀ.
fn eliminate(mut matrix: DMatrix<f64>, mut errors: DVector<f64>) -> DVector<f64> {
    let size = errors.len();
    let mut parts = DVector::zeros(size);
    for k in 0..size {
        let pivot = matrix[(k, k)];
        if pivot < REDUNDANCY_MIN {
            continue;
        }
        parts[k] = errors[k] * errors[k] / pivot;
        for row in k + 1..size {
            let factor = matrix[(row, k)] / pivot;
            errors[row] -= factor * errors[k];
            for column in k + 1..size {
                matrix[(row, column)] -= factor * matrix[(k, column)];
            }
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::geometry::Pose2;
    use crate::graph::{Edge, EdgeStatus, PoseGraph};
    use crate::ids::EdgeId;
    use crate::solver::testing::{add_closure, random_graph};
    use crate::solver::{SolveOptions, Solver, solve};

    const TIGHT: SolveOptions = SolveOptions {
        iterations_max: 100,
        cost_tolerance: 1e-14,
        step_tolerance: 1e-12,
    };

    /// A graph without errors, and new closures with small ones: Gauss-Newton's H is exact there.
    fn with_closures(seed: u64, count: u64) -> (PoseGraph, Vec<EdgeId>) {
        let mut noisy = random_graph(seed, 40, 8);
        let old = noisy.edges().len();
        let new = (0..count).map(|k| add_closure(&mut noisy, seed * 100 + k));
        let new: Vec<EdgeId> = new.collect();
        let mut graph = PoseGraph::new();
        for node in noisy.nodes() {
            graph.add_node(*node).unwrap();
        }
        for (k, edge) in noisy.edges().iter().enumerate() {
            let [from, to] = [edge.from, edge.to].map(|end| graph.node(end).unwrap().pose);
            let truth = from.between(&to);
            let scale = if k < old { 0.0 } else { 0.01 };
            let off = truth.between(&edge.measurement).log() * scale;
            let measurement = truth.compose(&Pose2::exp(&off));
            graph
                .add_edge(Edge {
                    measurement,
                    ..*edge
                })
                .unwrap();
        }
        (graph, new)
    }

    /// The increases of F, closure by closure.
    fn one_by_one(mut graph: PoseGraph, closures: &[EdgeId]) -> Vec<f64> {
        for id in closures {
            graph.set_edge_status(*id, EdgeStatus::Retired);
        }
        let mut solver = Solver::new();
        let mut increase = |id: &EdgeId| {
            graph.set_edge_status(*id, EdgeStatus::Active);
            solver.solve_touched(&mut graph, &[*id], &TIGHT).delta_f
        };
        closures.iter().map(&mut increase).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        #[test]
        fn closures_are_attributed_their_increases_one_by_one(seed in 0..100_000_u64, count in 1..5_u64) {
            let (mut graph, closures) = with_closures(seed, count);
            let expected = one_by_one(graph.clone(), &closures);
            let attributed = Solver::new().solve_closures(&mut graph, &closures, &TIGHT);
            let total: f64 = expected.iter().sum();
            prop_assert!((attributed.iter().sum::<f64>() - total).abs() <= 1e-4 * total + 1e-10);
            for (own, expected) in attributed.iter().zip(&expected) {
                prop_assert!(
                    (own - expected).abs() <= 0.01 * total + 1e-10,
                    "{:?} {:?}", attributed, expected
                );
            }
        }
    }

    /// Nothing else ties the last nodes: the first closure between them and the rest cannot cost
    /// anything, though without it the second would be the first.
    #[test]
    fn the_first_tie_costs_nothing() {
        let mut graph = random_graph(3, 40, 8);
        solve(&mut graph, &TIGHT);
        let mut closures = Vec::new();
        for seed in 0..1000 {
            let id = add_closure(&mut graph, seed);
            let edge = graph.edge(id).unwrap();
            if closures.len() < 3 && (edge.from.0 < 320) != (edge.to.0 < 320) {
                closures.push(id);
            } else {
                graph.set_edge_status(id, EdgeStatus::Retired);
            }
        }
        let expected = one_by_one(graph.clone(), &closures);
        let attributed = Solver::new().solve_closures(&mut graph, &closures, &TIGHT);
        assert!(expected[0].abs() < 1e-9 && attributed[0].abs() < 0.1 * expected[1]);
        assert!(expected[1] > 1e-3, "{expected:?}");
    }
}
