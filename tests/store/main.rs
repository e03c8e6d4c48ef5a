//! The contract of the store: what any backend must guarantee. Each law is held by the tests named with it.
//!
//! - **Uploads** (`journal`, `recorded`): an upload is stored before it is acknowledged. The same bytes under
//!   the same name are the same upload and change nothing; other bytes under that name are refused. A
//!   recording is stored whole or not at all.
//! - **Order within a trip** (`trips`, `jobs`, `edges`): batches are processed in the order of their
//!   sequence, one at a time. An early one waits for its turn, or until its time is over; a late one is
//!   quarantined with a reason.
//! - **Leases** (`jobs`, `lost`): a job is held by one worker at a time, and a route has one running job.
//!   Only the holder of the present lease can end the job. A job is tried five times; one whose process was
//!   lost is given back.
//! - **Results** (`graph`, `between`, `settled`): a result is written whole, or not at all if its lease or
//!   the route's revision has moved on. What is read back is what was written, to the bit.
//! - **Decisions** (`versions`, `tiers`, `audit`): a decision is refused if the route or the alert has
//!   changed since it was read. A change of the map begins a version, keeps the one before, and can be
//!   undone.
//! - **Audit** (`audit`, `keys`): every change that people make has one row, in the same transaction.
//! - **Handling** (`handling`): assignments, comments and zones do not raise an alert's own revision.
//! - **Deliveries** (`webhooks`, `notices`, `tiers`): an event is queued once for each webhook that
//!   subscribes to it, in the order of events, and attempted until it succeeds or is given up.
//! - **Deletion and retention** (`graph`, `settled`, `webhooks`): nothing is left of what is deleted, and
//!   what is still to be processed or sent is never deleted by age.
//! - **Names** (`names`): once their time is over, names and addresses of people are in no column of any table, but
//!   for those that are still needed; nothing else changes.
//! - **Views** (`views`, `parts`, `archive`, `alert_lists`): what is read of a part agrees with the whole,
//!   at one moment; the pages of a list follow each other without gap or repetition.
//! - **Journal of inputs** (`rebuilt`): it names everything that shaped a map, in order; repeating it makes
//!   the same map.
//!
//! `random` compares random work on the store with `model`, the contract in memory. `coverage` fails for a
//! method of the store that no test calls, `statements` for an SQL text that the database refuses. Files
//! that use SQL past the store are about SQLite, and their heads say for what.

// Helpers of tests may unwrap and panic as the tests themselves do.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod alert_lists;
mod archive;
mod audit;
mod between;
mod consistency;
mod coverage;
mod edges;
mod graph;
mod handling;
mod jobs;
mod journal;
mod keys;
mod life;
mod lost;
mod model;
mod names;
mod notices;
mod parts;
mod random;
mod rebuilt;
mod recorded;
mod rot;
mod settled;
mod sources;
mod sql_texts;
mod statements;
mod support;
#[path = "../common/tables.rs"]
mod tables;
mod tiers;
mod trips;
mod vehicles;
mod versions;
mod views;
mod webhooks;
