//! What the residuals of a pose graph say about changes of the world.

mod detector;
mod finding;
mod kind;
pub mod paper;
pub mod series;
pub mod threshold;

pub use detector::Detector;
pub use finding::Finding;
pub use kind::ChangeKind;
