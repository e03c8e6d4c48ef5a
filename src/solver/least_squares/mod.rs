//! The minimum of a sum of factors' costs over poses, by Gauss-Newton and Levenberg-Marquardt.
//!
//! A [`Problem`] has poses and factors by their places, with the names by which a caller knows them
//! again. Begin with [`Minimiser::minimise`].
//!
//! Must not know which part of a graph a problem is, nor what becomes of its poses: graphs are read
//! in one place, [`Problem::of_graph`].

mod minimise;
mod normal_equations;
mod problem;
mod summary;

pub(super) use minimise::Minimiser;
pub(super) use normal_equations::{DAMPING_MIN, NormalEquations, POSE_SIZE};
pub(super) use problem::{Known, Problem, factor_of_edge};
pub use summary::{SolveOptions, SolveSummary, Termination};
