//! The one sensor model: whether a scan from a known pose hits or misses a cell.
//!
//! Knows beams, ranges and noise; must not know trips, passes or changes. Begin with [`Observation::test`].

mod cell;
mod ray_test;
#[cfg(test)]
pub(crate) mod testing;

pub use cell::{Cell, CellBuilder};
pub use ray_test::{Observation, Outcome, REACH_M, Visibility, miss_tolerance, reach_m};
