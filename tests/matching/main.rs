//! Scan matching against simulated truth.

// Helpers of tests may unwrap and panic as the tests themselves do.
#![allow(clippy::unwrap_used)]

mod align;
mod calibration;
mod degenerate;
#[path = "../common/scans.rs"]
mod scans;
mod search;
mod visibility;
