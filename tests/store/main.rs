//! The store against a database in a temporary directory.

mod consistency;
mod graph;
mod jobs;
mod journal;
mod life;
mod support;
mod trips;
