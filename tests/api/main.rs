//! The whole service over real sockets: contract, refusals, idempotency, limits, shutdown.

mod bad_requests;
mod body;
mod client;
mod lifecycle;
mod limits;
mod resources;
mod service;
mod uploads;
