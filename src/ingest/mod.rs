//! Uploads and recordings of other programs: bytes to core types, and graphs back to bytes.
//!
//! Knows scans and graphs; knows nothing of where bytes come from or what becomes of them. A format
//! is a file: begin with [`batch_json::decode`] for uploads and [`CarmenLog::read`] for recordings.

pub mod batch_json;
pub mod edges_json;
pub mod g2o;
pub mod json;

mod body_error;
mod carmen;
mod carmen_line;

pub use carmen::{CarmenClock, CarmenError, CarmenLog, CarmenScan};
pub use carmen_line::SkipReason;
