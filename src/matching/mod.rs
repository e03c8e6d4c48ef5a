//! Where one scan was taken, relative to others: nearest points, point-to-line ICP in its robust
//! and its all-points form, how well its result is told from those beside it, the global search,
//! and what one scan sees of another's points.

mod cloud;
mod contrast;
mod estimate;
mod icp;
mod likelihood;
mod normal_equations;
mod pairing;
mod point_grid;
mod search;
mod smooth;
#[cfg(test)]
mod testing;
mod visibility;

pub use cloud::{Neighbour, ReferenceCloud};
pub use contrast::Contrast;
pub use estimate::{Estimate, Termination};
pub use icp::{Alignment, IcpParams, Prior, align};
pub use likelihood::LikelihoodGrid;
pub use search::{SearchHit, SearchParams, SearchWindow, search};
pub use visibility::{Agreement, View, Views, Visibility, agreement};
