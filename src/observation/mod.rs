//! The one sensor model: what a scan, taken from a known pose, says about a place.
//!
//! It knows beams, ranges and noise; it knows nothing of trips, passes or changes. Begin with
//! [`Observation::test`].

mod cell;
mod ray_test;
#[cfg(test)]
pub(crate) mod testing;

pub use cell::{Cell, CellBuilder};
pub use ray_test::{Observation, Outcome, REACH_M, Visibility, miss_tolerance, reach_m};
