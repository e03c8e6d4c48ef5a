//! The systematic errors of a vehicle, from what its drives showed.

mod blocks;
mod clock_offset;
mod corrections;
mod estimate;
mod motion_fit;
mod motion_model;
mod motions;
mod odometry_track;
mod quantity;
#[cfg(test)]
mod testing;

pub use clock_offset::{DrivenPose, clock_offset_s};
pub use corrections::Corrections;
pub use estimate::{Combined, Estimate, Estimates};
pub use motion_fit::{MotionFit, fit_motions};
pub use motions::{Motions, ScanMotion, is_complete};
pub use odometry_track::OdometryTrack;
pub use quantity::Quantity;
