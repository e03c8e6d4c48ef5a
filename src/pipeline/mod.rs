//! From the journal to the map: workers that claim a batch, load its route, compute, and save
//! everything that came of it in one transaction.
//!
//! A job is never worked on inside a transaction. What a worker computed is refused by the store
//! if its lease was lost or the route has moved on; then it is dropped and computed anew.

mod process;
mod result;
mod stage;
mod worker;
mod workspace;

pub use worker::start_workers;
