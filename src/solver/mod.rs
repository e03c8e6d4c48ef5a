//! Least squares on pose graphs: the poses p* that minimise F = Σ eᵀΩe (paper, equations 2, 3).
//!
//! Only active edges take part. Each connected component's gauge is held by its first node.
//!
//! Rooms, each using only those before it:
//!
//! 1. [`linear`]: sparse symmetric systems.
//! 2. `factor`: measured motions, their errors and derivatives.
//! 3. `least_squares`: poses and factors by their places, and the minimum of their cost.
//! 4. `whole`: all of a graph at once: starts, robust solving, how uncertain poses are.
//! 5. `incremental`: the part of a growing graph that new edges touch.
//!
//! Begin with [`solve`], or with [`Solver`] for a graph that grows.

mod effort;
mod factor;
mod incremental;
mod interrupt;
mod least_squares;
pub mod linear;
#[cfg(test)]
mod testing;
mod whole;

pub use effort::operations_to_solve;
pub use incremental::{Solver, TouchedSummary};
pub use interrupt::Interrupt;
pub use least_squares::{SolveOptions, SolveSummary, Termination};
pub use whole::{
    ClosureError, Innovation, Marginals, PoseErrors, RobustSummary, solve, solve_from_chordal,
    solve_robust, start_along_odometry,
};
