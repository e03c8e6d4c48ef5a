//! One sweep of a 2D lidar: the validated scan, its points, its compact form, the keyframe rule; and
//! virtual ones, of height bands of the clouds of a 3D lidar ([`BandScanner`]).
//!
//! Must not know where a scan was taken. Begin with [`LaserScan::new`].

mod band;
mod cloud;
mod codec;
mod keyframe;
mod laser_scan;
mod lidar;
mod limits;
mod points;
mod undistort;

pub use band::{BAND_HIGHEST_M, BAND_LOWEST_M, BAND_THINNEST_M, BandError, BandView, HeightBand};
pub use cloud::{BandScanner, CloudError, CloudLidar};
pub use codec::{CodecError, decode_scan, encode_scan};
pub use keyframe::{KeyframeRule, is_standing};
pub use laser_scan::{INVALID_TICK, LaserScan, NO_RETURN_TICK, Reading, ScanError};
pub use lidar::{Lidar, LidarError, RANGE_SIGMA_DEFAULT_M};
pub use limits::{BEAMS_MAX, RANGE_MAX_M};
pub use points::{SurfacePoint, surface_points};
pub use undistort::SweepOrder;
