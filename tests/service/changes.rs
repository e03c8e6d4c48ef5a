//! The world changes between laps: what the service tells of it, from the upload to the alert.

mod bands;
mod decisions;
mod faults;
mod order;
mod picture;
mod raised;
mod reordering;
mod reported;
mod shop;
mod webhooks;

pub use reported::{ROUTE, alerts, only};
pub use shop::Shop;
