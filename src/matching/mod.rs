//! Where one scan was taken, relative to others: nearest points, point-to-line ICP in its robust
//! and its all-points form, the global search, and what one scan sees of another's points.

mod cloud;
mod estimate;
mod icp;
mod likelihood;
mod normal_equations;
mod pairing;
mod point_grid;
mod search;
mod visibility;

pub use cloud::{Neighbour, ReferenceCloud};
pub use estimate::{Estimate, Termination};
pub use icp::{Alignment, IcpParams, Prior, align};
pub use likelihood::LikelihoodGrid;
pub use search::{SearchHit, SearchParams, SearchWindow, search};
pub use visibility::{Agreement, View, Visibility, agreement};
