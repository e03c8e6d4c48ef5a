//! What the store keeps, as values.

mod batches;
mod edges;
mod jobs;
mod nodes;
mod routes;

pub use batches::*;
pub use edges::*;
pub use jobs::*;
pub use nodes::*;
pub use routes::*;
