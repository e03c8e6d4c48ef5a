//! What the residuals of a pose graph say about changes of the world.

mod detect;
mod detector;
mod finding;
mod history;
mod kind;
mod look;
pub mod paper;
mod region;
pub mod series;
pub mod threshold;

pub use detect::{Evidence, Settled, Suspicion, detect};
pub use detector::Detector;
pub use finding::Finding;
pub use kind::ChangeKind;
pub use look::{Look, Sight};
