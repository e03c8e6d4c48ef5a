//! Whole drives through the whole service: what goes in over HTTP is what comes out of the map,
//! whatever the order, the kills and the oddities on the way.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![allow(clippy::print_stderr)]

mod agreement;
mod attacks;
mod backup;
mod changes;
mod client;
mod commands;
mod drives;
mod edge_laps;
mod edges;
mod intel;
mod lidars;
mod names;
mod odd_trips;
mod order;
mod parallel;
mod people;
#[path = "../common/process.rs"]
#[allow(dead_code, reason = "the tests of reliability use more of it")]
mod process;
mod quarantines;
#[path = "../common/receiver.rs"]
#[allow(dead_code, reason = "the tests of the interface use more of it")]
mod receiver;
mod removals;
mod replay;
mod restart;
mod rot;
mod running;
mod spoiled;
mod state;
#[path = "../common/tables.rs"]
mod tables;
