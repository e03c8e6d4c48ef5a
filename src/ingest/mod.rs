//! Uploads and recordings of other programs: bytes to core types, and graphs back to bytes.
//!
//! Knows scans and graphs; knows nothing of where bytes come from or what becomes of them. A format
//! is a file: begin with [`batch_json::decode`] for uploads, [`Recording::open`] for recordings, and
//! [`RouteRecording`] for a route as one.

pub mod batch_json;
pub mod edges_json;
pub mod g2o;
pub mod json;
pub mod mcap;

mod batch_writer;
mod body_error;
mod carmen;
mod carmen_line;
mod extensions;
mod recorded;
mod recording;
mod route_recording;
mod stamp;

pub use batch_writer::{
    BatchHead, BatchWriter, PoseJson, ScanToWrite, WriteError, WrittenBatch, pose_json, write_batch,
};
pub use carmen::{CarmenClock, CarmenError, CarmenLog};
pub use carmen_line::SkipReason;
pub use extensions::{EXTENSIONS_BYTES_MAX, EXTENSIONS_DEPTH_MAX};
pub use recorded::{LidarLog, RecordedLidar, RecordedScan};
pub use recording::{RecordedScans, Recording, RecordingError, format_of, format_title};
pub use route_recording::{
    ExportedAlert, ExportedGrid, ExportedKeyframe, ExportedScan, RouteRecording,
    RouteRecordingError,
};
