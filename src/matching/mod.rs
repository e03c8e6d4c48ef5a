//! Where one scan was taken, relative to others: nearest points, point-to-line ICP in its robust
//! and its all-points form, how well its result is distinguished from those beside it, the global
//! search, and what one scan says of another's points.
//!
//! Knows nothing of graphs or odometry. Begin with [`align`].

mod cloud;
mod contrast;
mod estimate;
mod icp;
mod icp_params;
mod likelihood;
mod normal_equations;
mod pairing;
mod point_grid;
mod prior;
mod search;
mod smooth;
#[cfg(test)]
mod testing;
mod visibility;

pub use cloud::ReferenceCloud;
pub use contrast::{BESIDE_A_PLACE_M, BESIDE_A_STEP_M, Contrast};
pub use estimate::{Estimate, Termination};
pub use icp::{Alignment, align};
pub use icp_params::IcpParams;
pub use likelihood::LikelihoodGrid;
pub use point_grid::Neighbour;
pub use prior::Prior;
pub use search::{SearchHit, SearchParams, SearchWindow, search};
pub use visibility::{Agreement, DepthTolerance, View, Views, Visibility, agreement};
