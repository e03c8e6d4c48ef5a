//! The whole service over real sockets: contract, refusals, idempotency, limits, shutdown.

// The lints spare test functions only, not the helpers beside them.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod access;
mod alert_stream;
mod alerts;
mod audit;
mod bad_alert_requests;
mod bad_requests;
mod bad_webhook_requests;
mod body;
mod changed_hall;
mod client;
mod contract;
mod crowds;
mod edge_batches;
mod foreign_heads;
mod handling;
mod hooked;
mod keys;
mod lifecycle;
mod limits;
mod log;
mod map_layers;
mod notices;
mod operators;
mod proxies;
#[path = "../common/receiver.rs"]
mod receiver;
mod recordings;
mod releases;
mod resources;
mod secrets;
mod service;
mod sessions;
mod tiles;
mod traffic;
mod uploads;
mod vehicles;
mod version_diff;
mod webhook_attempts;
mod webhook_events;
mod webhooks;
mod zones;
