//! The systematic errors of a vehicle, from what its drives showed.

mod blocks;
mod clock_offset;
mod corrections;
mod estimate;
mod joint_match;
mod motion_fit;
mod motion_model;
mod motion_terms;
mod motions;
mod odometry_track;
mod quantity;
mod range_scale;
mod shared_value;
mod spacing;
mod spacing_matches;
mod spacing_walls;
#[cfg(test)]
mod testing;
mod trip;
mod vehicle;

pub use clock_offset::{DrivenPose, clock_offset_s};
pub use corrections::Corrections;
pub use estimate::{Combined, Estimate, Estimates};
pub use motion_fit::{MotionFit, fit_motions};
pub use motions::{Motions, ScanMotion, is_complete};
pub use odometry_track::OdometryTrack;
pub use quantity::Quantity;
pub use range_scale::{MapScan, range_scale};
pub use spacing::Spacing;
pub use spacing_matches::{ScanPair, spacing_by_matches};
pub use spacing_walls::spacing_by_walls;
pub use trip::TripCalibration;
pub use vehicle::{Change, VehicleCalibration};
