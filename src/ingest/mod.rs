//! Uploads and recordings of other programs: bytes to core types, and graphs back to bytes.
//!
//! Knows scans and graphs; knows nothing of where bytes come from or what becomes of them. A format
//! is a file: begin with [`batch_json::decode`] for uploads, [`CarmenLog::read`] for recordings, and
//! [`RouteRecording`] for a route as one.

pub mod batch_json;
pub mod edges_json;
pub mod g2o;
pub mod json;

mod body_error;
mod carmen;
mod carmen_line;
mod extensions;
mod route_recording;
mod stamp;

pub use carmen::{CarmenClock, CarmenError, CarmenLog, CarmenScan};
pub use carmen_line::SkipReason;
pub use extensions::{EXTENSIONS_BYTES_MAX, EXTENSIONS_DEPTH_MAX};
pub use route_recording::{
    ExportedAlert, ExportedGrid, ExportedKeyframe, ExportedScan, RouteRecording,
    RouteRecordingError,
};
