//! The store against a database in a temporary directory.

// Helpers of tests may unwrap and panic as the tests themselves do.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod archive;
mod audit;
mod between;
mod consistency;
mod edges;
mod graph;
mod jobs;
mod journal;
mod keys;
mod life;
mod lost;
mod notices;
mod rot;
mod settled;
mod support;
mod tiers;
mod trips;
mod vehicles;
mod webhooks;
