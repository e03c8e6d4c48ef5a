//! What the residuals of a pose graph say about changes of the world.

mod detector;
pub mod series;
pub mod threshold;

pub use detector::Detector;
