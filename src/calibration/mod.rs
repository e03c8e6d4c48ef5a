//! The systematic errors of a vehicle, from what its trips show: where its lidar truly sits, how its
//! wheels and its clock err, how far its beams are apart. Every estimate is one of the difference to
//! what was *stated*, whatever is applied elsewhere.
//!
//! Knows nothing of maps or storage. Begin with [`TripCalibration::of_scans`], the whole way of one
//! trip; [`VehicleCalibration`] decides what is applied, [`Corrections`] apply it.

mod blocks;
mod clock_offset;
mod companion_mount;
mod corrections;
mod episodes;
mod estimate;
mod joint_match;
mod map_fit;
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
mod trip_corrections;
mod trip_scans;
mod vehicle;
mod vehicle_fault;
mod way_scale;

pub use crate::model::Quantity;
pub use clock_offset::{DrivenPose, clock_offset_s};
pub use companion_mount::CompanionScan;
pub use corrections::Corrections;
pub use estimate::{Combined, Estimate, Estimates};
pub use map_fit::MapFit;
pub use motion_fit::{MotionFit, fit_motions};
pub(crate) use motion_terms::median;
pub use motions::{Motions, ScanMotion, is_complete};
pub use odometry_track::OdometryTrack;
pub use range_scale::MapScan;
pub use spacing::Spacing;
pub use spacing_matches::{ScanPair, spacing_by_matches};
pub use spacing_walls::spacing_by_walls;
pub use trip::TripCalibration;
pub use trip_corrections::{AppliedCorrection, TripCorrections};
pub use trip_scans::{TripScan, matched_motions};
pub use vehicle::{CalibratedTrip, Change, TRIPS_MAX, VehicleCalibration};
pub use vehicle_fault::{Displacement, VehicleFault};
pub use way_scale::{DrivenStep, way_scale};
