//! What the residuals of a pose graph say about changes of the world.

pub mod series;
pub mod threshold;
