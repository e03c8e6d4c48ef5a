//! All of a graph at once: its optimum from several starts, its false closures, its uncertainty.
//!
//! Begin with [`solve`].
//!
//! Must not know what was solved before, nor the blocks of a graph.

mod chordal;
mod marginals;
mod pose_errors;
mod robust;
mod solve;
mod spanning;

pub use marginals::{Innovation, Marginals};
pub use pose_errors::{ClosureError, PoseErrors};
pub use robust::{RobustSummary, solve_robust};
pub use solve::{solve, solve_from_chordal};
pub use spanning::start_along_odometry;
