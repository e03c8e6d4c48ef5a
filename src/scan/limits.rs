//! How large a scan may be.

/// Most beams a scan may have.
pub const BEAMS_MAX: usize = 8_192;
/// Longest `range_max_m`.
pub const RANGE_MAX_M: f64 = 500.0;
