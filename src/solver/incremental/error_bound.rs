//! How far a block may be from its optimum after a part of it was solved: an upper bound from the
//! principle of complementary energy.
//!
//! With the gradient g of F/2 and H = Σ JᵀΩJ, the optimum is gᵀH⁻¹g below F, to second order. For
//! any strains u of the edges that stand in for g, Σ JᵀΩu = g at every node, Σ uᵀΩu is no less than
//! that: gᵀH⁻¹g = min Σ uᵀΩu. An edge's forces on its two ends are equal and opposite whatever its
//! strain, so forces that a part's solve leaves at its ring can be carried by the part's own edges,
//! and the bound needs no look at the rest.

use nalgebra::Vector3;

use super::region::Region;
use crate::geometry::Information;
use crate::graph::{BlockIndex, PoseGraph};
use crate::solver::factor::{Factor, Frame, fill_batches};
use crate::solver::least_squares::{DAMPING_MIN, NormalEquations, POSE_SIZE, Problem};

/// A node whose coordinates the bound's equations hold takes up what is left over. It is nothing
/// but for rounding and bending; more than this part of the forces and the bound is not believed.
const LEFT_OVER_MAX: f64 = 1e-3;
/// Forces below this part of those that balance each other are rounding.
const ROUNDING: f64 = 1e-10;

/// Strains that stand in for the gradient.
pub(super) struct Strains {
    /// Of each of the region's edges.
    pub(super) of_edges: Vec<Vector3<f64>>,
    /// Σ uᵀΩu over them.
    pub(super) energy: f64,
    /// The same before the region was solved.
    pub(super) energy_before: f64,
}

/// The least strains of a region's edges that stand in for the gradient at the region's nodes,
/// with the strains outside as they are; `None` if there are none. `solved` is the region's
/// problem with the poses after the solve.
pub(super) fn least_strains(
    graph: &PoseGraph,
    block: BlockIndex,
    region: &Region,
    solved: &Problem,
) -> Option<Strains> {
    let strains_before = &graph.blocks().get(block)?.standing.strains;
    let mut forces = vec![Vector3::zeros(); solved.poses.len()];
    let mut scale = 0.0;
    for factor in &solved.factors {
        let [from, to] = [factor.from, factor.to].map(|pose| Frame::of(solved.poses[pose]));
        let pull = Pull::of(&from, &to, &factor.measurement, &factor.information, None);
        scale += pull.from.amax() + pull.to.amax();
        forces[factor.from] += pull.from;
        forces[factor.to] += pull.to;
    }
    // Nothing that these edges join was moved.
    for (place, position) in region.edges_out(graph, block) {
        let (edge, (from, to)) = (&graph.edges()[position], graph.ends()[position]);
        let poses = [from, to].map(|node| Frame::of(graph.nodes()[node].pose));
        let strain = strains_before.get(&position);
        let pull = Pull::of(
            &poses[0],
            &poses[1],
            &Frame::of(edge.measurement),
            &edge.information,
            strain,
        );
        let at_ring = if from == region.nodes[place] {
            pull.from
        } else {
            pull.to
        };
        forces[place] += at_ring;
    }
    let before = region.edges.iter().zip(&solved.factors);
    let energy_before = before
        .filter_map(|(edge, factor)| Some((strains_before.get(edge)?, factor)))
        .map(|(strain, factor)| factor.information.squared_norm(strain))
        .sum();
    strains_for(solved, forces, scale, energy_before)
}

fn strains_for(
    solved: &Problem,
    mut forces: Vec<Vector3<f64>>,
    scale: f64,
    energy_before: f64,
) -> Option<Strains> {
    let components = solved.components();
    let loose = Problem {
        held: (0..components.len()).map(|k| components[k] == k).collect(),
        ..solved.clone()
    };
    let frames: Vec<Frame> = loose.poses.iter().map(|&pose| Frame::of(pose)).collect();
    let mut equations = NormalEquations::new(&loose, false)?;
    let mut batches = Vec::new();
    fill_batches(&loose.factors, &mut batches);
    equations.linearise(&batches, &frames);
    if !equations.factorise(DAMPING_MIN) {
        return None;
    }
    let mut column = vec![0.0; equations.dimension()];
    for (pose, force) in forces.iter().enumerate() {
        if let Some(at) = equations.offset(pose) {
            column[at..at + POSE_SIZE].copy_from_slice(force.as_slice());
        }
    }
    equations.solve(&mut column);
    let shift = |pose: usize| {
        let at = equations.offset(pose);
        at.map_or(Vector3::zeros(), |at| {
            Vector3::from_column_slice(&column[at..at + POSE_SIZE])
        })
    };
    let total: f64 = forces.iter().map(Vector3::amax).sum();
    let mut strains = Strains {
        of_edges: Vec::with_capacity(loose.factors.len()),
        energy: 0.0,
        energy_before,
    };
    for Factor {
        from,
        to,
        measurement,
        information,
        ..
    } in &loose.factors
    {
        let at = Frame::local_error(&frames[*from], &frames[*to], measurement);
        let strain = at.jacobian_from * shift(*from) + at.jacobian_to * shift(*to);
        let stress = information.matrix() * strain;
        forces[*from] -= at.jacobian_from.tr_mul(&stress);
        forces[*to] -= at.jacobian_to.tr_mul(&stress);
        strains.energy += strain.dot(&stress);
        strains.of_edges.push(strain);
    }
    let left_over = forces.iter().map(Vector3::amax).fold(0.0, f64::max);
    let balanced = left_over <= LEFT_OVER_MAX * total + ROUNDING * scale;
    (balanced && strains.energy.is_finite()).then_some(strains)
}

/// An edge's part in the gradient at its two ends, for steps in their own frames.
struct Pull {
    from: Vector3<f64>,
    to: Vector3<f64>,
}

impl Pull {
    /// By its error, less a strain.
    fn of(
        from: &Frame,
        to: &Frame,
        measurement: &Frame,
        information: &Information,
        strain: Option<&Vector3<f64>>,
    ) -> Self {
        let at = Frame::local_error(from, to, measurement);
        let error = strain.map_or(at.error, |strain| at.error - strain);
        let stress = information.matrix() * error;
        Self {
            from: at.jacobian_from.tr_mul(&stress),
            to: at.jacobian_to.tr_mul(&stress),
        }
    }
}
