//! Least squares on pose graphs: the poses p* that minimise F = Σ eᵀΩe (paper, equations 2, 3).
//!
//! Only active edges take part. Each connected component's gauge is held by its first node.

mod aligned;
mod arena;
mod assembly;
mod block_matrix;
mod block_problem;
mod cholesky;
#[cfg(test)]
mod cholesky_tests;
mod chordal;
mod complementary;
mod dense;
mod elimination;
mod front;
mod local_error;
mod marginals;
mod minimise;
mod multifrontal;
mod normal_equations;
mod ordering;
mod packs;
mod part;
mod pose_errors;
mod problem;
mod region;
mod robust;
mod secants;
mod selected_inverse;
mod shares;
mod spanning;
mod summary;
#[cfg(test)]
mod testing;
mod touched;
mod trigonometry;
mod whole;
mod wide;

pub use marginals::{Innovation, Marginals};
pub use pose_errors::{ClosureError, PoseErrors};
pub use robust::{RobustSummary, solve_robust};
pub use spanning::start_along_odometry;
pub use summary::{SolveOptions, SolveSummary, Termination};
pub use touched::{Solver, TouchedSummary};
pub use whole::{solve, solve_from_chordal};
