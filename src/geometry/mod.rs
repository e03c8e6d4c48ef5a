//! Rigid motions of the plane, angles, and how uncertain they are.
//!
//! Knows nothing of scans or graphs. Begin with [`Pose2::compose`].

mod angle;
mod convex_hull;
mod information;
mod polygon;
mod pose2;
mod pose_sigma;

pub use angle::{angle_difference_rad, direction_rad, wrap_angle};
pub use convex_hull::{convex_hull, rectangle_round};
pub use information::Information;
pub use polygon::{distance_to_polygon, is_simple_polygon, polygon_area, polygon_gap};
pub use pose_sigma::PoseSigma;
pub use pose2::{EdgeError, Pose2, Tangent2, Transform2};

pub use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
