//! The world changes between laps: what the service tells of it, from the upload to the alert.

mod bands;
mod decisions;
mod faults;
mod order;
mod picture;
mod raised;
mod reordering;
mod shop;
mod told;
mod webhooks;

pub use shop::Shop;
pub use told::{ROUTE, alerts, only};
