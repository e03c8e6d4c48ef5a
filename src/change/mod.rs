//! What the residuals of a pose graph say about changes of the world.

mod beam_verdict;
mod detector;
mod finding;
mod kind;
pub mod series;
pub mod threshold;

pub use beam_verdict::{BeamVerdict, DepthTolerance, JudgedBeam, PlacedScan, judge_beams};
pub use detector::Detector;
pub use finding::Finding;
pub use kind::ChangeKind;
