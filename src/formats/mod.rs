//! Bytes to core types and back.

pub mod batch_json;
pub mod json;
