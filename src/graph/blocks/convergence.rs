//! The convergence state of a block: how near its poses are to its optimum.

use std::collections::BTreeMap;

use nalgebra::Vector3;

/// What solves have made of a block so far. It is kept with the block, because it is joined when
/// blocks are.
#[derive(Debug, Clone, PartialEq)]
pub struct ConvergenceState {
    /// Whether the block was solved to its optimum, but for `fresh` edges and for `strains`.
    pub solved: bool,
    /// Places of the edges that came after that.
    pub fresh: Vec<usize>,
    /// The block's share of F without the fresh edges, while `solved`.
    pub cost: f64,
    /// What stands in for the gradient g that solves of parts have left: strains u of edges, by
    /// their places, with g = Σ JᵀΩu at every node.
    pub strains: BTreeMap<usize, Vector3<f64>>,
    /// Σ uᵀΩu over `strains`. By the principle of complementary energy the block's share of F is
    /// above its optimum by no more than this, to second order.
    pub gap_max: f64,
}

impl ConvergenceState {
    /// Of a block that nobody has solved.
    pub fn unknown() -> Self {
        Self {
            solved: false,
            ..Self::optimal(0.0)
        }
    }

    /// Of a block that is at its optimum.
    pub fn optimal(cost: f64) -> Self {
        Self {
            solved: true,
            fresh: Vec::new(),
            cost,
            strains: BTreeMap::new(),
            gap_max: 0.0,
        }
    }

    /// Of an edge that has just come in.
    pub(super) fn fresh(edge_position: usize) -> Self {
        Self {
            fresh: vec![edge_position],
            ..Self::optimal(0.0)
        }
    }

    /// Takes in what is known of another block that is now one with this.
    pub(super) fn join(&mut self, mut other: Self) {
        self.solved &= other.solved;
        if !self.solved {
            *self = Self::unknown();
            return;
        }
        if self.strains.len() < other.strains.len() {
            std::mem::swap(&mut self.strains, &mut other.strains);
        }
        self.strains.extend(other.strains);
        self.fresh.append(&mut other.fresh);
        self.cost += other.cost;
        self.gap_max += other.gap_max;
    }
}
