//! Clocks of vehicles that are ahead.
//!
//! The passes at a place are judged in the order of their stamps. A vehicle whose clock is years ahead
//! would be the newest witness for years; so its trips count from when they arrived. One whose clock is
//! behind cannot be told from one that uploads late.

use jiff::Timestamp;

use crate::ids::TripId;
use crate::mapping::{DriveScan, RouteMap};

/// Farther ahead a clock is not believed, nanoseconds.
const AHEAD_MAX_NS: i64 = 7 * 24 * 3_600 * 1_000_000_000;
/// Between the newest scan of others and the first of a trip that is put behind it, nanoseconds.
const GAP_NS: i64 = 1_000_000_000;

/// What is to be taken from the stamps of a trip that begins with these scans, nanoseconds: 0 if its
/// clock is believed. The trip stays behind all that was before it by its own stamps, even if those are
/// ahead as well: simulated days are driven in minutes.
pub(super) fn clock_ahead_ns(
    scans: &[DriveScan],
    received_at: Timestamp,
    map: &RouteMap,
    trip: &TripId,
) -> i64 {
    let (Some(first), Some(last)) = (scans.first(), scans.last()) else {
        return 0;
    };
    let received_ns = i64::try_from(received_at.as_nanosecond()).unwrap_or(i64::MAX);
    let ahead_ns = last.stamp.0.saturating_sub(received_ns);
    if ahead_ns <= AHEAD_MAX_NS {
        return 0;
    }
    let others = map.keyframes().iter().filter(|other| other.trip != *trip);
    let stamps = others.flat_map(|other| {
        let behind = other.intermediate.iter().map(|scan| scan.stamp.0);
        behind.chain([other.stamp.0])
    });
    let before = stamps.filter(|stamp| *stamp < first.stamp.0).max();
    match before {
        Some(before) => ahead_ns.min(first.stamp.0 - before - GAP_NS).max(0),
        None => ahead_ns,
    }
}
