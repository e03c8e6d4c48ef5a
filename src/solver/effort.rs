//! The cost of solving a graph, estimated beforehand.

use super::linear::{BlockMatrix, approximate_minimum_degree, operations_to_factor};

/// Unknowns of a pose.
const POSE_SIZE: usize = 3;

/// Number of multiplications of one factorisation of the equations of a graph with this number of nodes
/// and these edges, as pairs of node indices; `None` if memory runs out.
pub fn operations_to_solve(nodes: usize, edges: &[(u32, u32)]) -> Option<f64> {
    let order = approximate_minimum_degree(nodes, edges)?;
    let mut matrix = BlockMatrix::<POSE_SIZE>::default();
    matrix.reserve(nodes, edges.len());
    let mut variables = vec![0; nodes];
    for node in order {
        variables[node as usize] = matrix.add_variable();
    }
    for (a, b) in edges.iter().filter(|(a, b)| a != b) {
        matrix.add_pair(variables[*a as usize], variables[*b as usize]);
    }
    Some(operations_to_factor(&matrix))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cubes(variables: usize) -> f64 {
        let n = (variables * POSE_SIZE) as f64;
        n * (n + 1.0) * (2.0 * n + 1.0) / 12.0
    }

    #[test]
    fn a_chain_costs_as_much_as_it_is_long_and_a_full_graph_its_cube() {
        let of_chain = |nodes: u32| {
            let chain: Vec<_> = (1..nodes).map(|k| (k - 1, k)).collect();
            operations_to_solve(nodes as usize, &chain).unwrap()
        };
        let (short, long) = (of_chain(60), of_chain(120));
        assert!(
            long < 2.2 * short && short < 60.0 * cubes(4),
            "{short} {long}"
        );
        let full: Vec<_> = (0..60).flat_map(|a| (0..a).map(move |b| (a, b))).collect();
        let of_full = operations_to_solve(60, &full).unwrap();
        assert_eq!(of_full, cubes(60));
    }
}
