//! Routes' maps grown from simulated drives, compared with the truth.

// Helpers of tests may unwrap and panic as the tests themselves do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod anchors;
mod laps;
mod lidars;
mod restored;
#[allow(dead_code, reason = "the matching tests use the rest")]
#[path = "../common/scans.rs"]
mod scans;
mod short_sighted;
mod strange;
mod support;
mod weighting;
