//! A graph that grows: only the biconnected blocks that new edges touch are solved, and what is
//! known of them is kept from one solve to the next.
//!
//! Begin with [`Solver::solve_touched`].
//!
//! Must not know who adds edges, or why. Memory makes it faster and never shows in the optimum.

mod attribution;
mod block_problem;
mod touched;

pub use touched::{Solver, TouchedSummary};
