//! How much a pipeline keeps.

use std::time::Duration;

use crate::mapping::{ACTIVE_STRETCHES, FIRST_STRETCHES};

/// How much a pipeline keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PipelineOptions {
    /// Memory for maps between their batches, bytes. Maps that are worked on come on top of it: one
    /// for each core.
    pub map_memory_bytes: usize,
    /// So many of the newest stretches of drives stay in a route's map; of older ones the
    /// references, and what alerts rest on that wait for a decision, …
    pub active_stretches: usize,
    /// … and of every place what so many stretches drove there, the oldest.
    pub first_stretches: usize,
    /// How long the bodies of merged batches are kept after they were processed; `None` for ever.
    pub keep_bodies: Option<Duration>,
    /// How long the scans between archived keyframes are kept after their batch was processed; `None` for
    /// ever.
    pub keep_trajectories: Option<Duration>,
}

impl Default for PipelineOptions {
    fn default() -> Self {
        Self {
            map_memory_bytes: 1 << 30,
            active_stretches: ACTIVE_STRETCHES,
            first_stretches: FIRST_STRETCHES,
            keep_bodies: None,
            keep_trajectories: None,
        }
    }
}
