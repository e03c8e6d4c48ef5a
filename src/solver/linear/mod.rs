//! Symmetric positive definite systems of sparse B × B blocks: ordering, factorisation, solution.
//!
//! A caller couples variables in a [`BlockMatrix`], numbered in the order in which they are to be
//! eliminated ([`approximate_minimum_degree`] finds one), has its structure analysed once, and
//! factors and solves as often as the numbers change. Begin with [`BlockCholesky::factorise`].
//!
//! Must not know what the variables are: no poses, no edges, no graph of either.

mod aligned;
mod arena;
mod assembly;
mod block_matrix;
mod cholesky;
mod dense;
mod elimination;
mod front;
mod multifrontal;
mod ordering;
mod quasi_newton;
mod selected_inverse;

pub use block_matrix::BlockMatrix;
pub use cholesky::BlockCholesky;
pub use elimination::operations_to_factor;
pub use ordering::approximate_minimum_degree;
pub(super) use quasi_newton::{QuasiNewton, dot};
pub(super) use selected_inverse::SelectedInverse;
