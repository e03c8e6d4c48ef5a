//! How much a pipeline keeps.

use std::time::Duration;

use crate::mapping::{ACTIVE_STRETCHES, FIRST_STRETCHES};

/// How much a pipeline keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PipelineOptions {
    /// Memory for maps that are not being worked on, bytes. Up to one map for each core comes on top.
    pub map_memory_bytes: usize,
    /// How many of the newest trip segments stay active. Of older ones only references and the evidence of
    /// pending alerts do, …
    pub active_segments: usize,
    /// … and at every place the scans of this many of the first segments.
    pub first_segments: usize,
    /// How long the bodies of merged batches are kept after processing; `None` for ever.
    pub keep_bodies: Option<Duration>,
    /// How long the scans between archived keyframes are kept after their batch was processed; `None` for
    /// ever.
    pub keep_trajectories: Option<Duration>,
    /// How long the names and addresses of people are kept after they were written; `None` for ever.
    pub keep_names: Option<Duration>,
}

impl Default for PipelineOptions {
    fn default() -> Self {
        Self {
            map_memory_bytes: 1 << 30,
            active_segments: ACTIVE_STRETCHES,
            first_segments: FIRST_STRETCHES,
            keep_bodies: None,
            keep_trajectories: None,
            keep_names: None,
        }
    }
}
