//! CPU time of the calling thread.

use std::time::Instant;

/// A watch that stands still while other threads have the processor, where Linux says so.
pub(super) struct CpuWatch {
    on_cpu_ns: Option<u64>,
    started: Instant,
}

impl CpuWatch {
    pub(super) fn start() -> Self {
        Self {
            on_cpu_ns: on_cpu_ns(),
            started: Instant::now(),
        }
    }

    /// CPU seconds since the start; elapsed seconds where CPU time is not known.
    pub(super) fn seconds(&self) -> f64 {
        match (self.on_cpu_ns, on_cpu_ns()) {
            (Some(before), Some(now)) => now.saturating_sub(before) as f64 * 1e-9,
            _ => self.started.elapsed().as_secs_f64(),
        }
    }
}

fn on_cpu_ns() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse().ok()
}
