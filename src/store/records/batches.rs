//! Uploads, with and without their bodies.

use jiff::Timestamp;

use crate::ids::{BatchId, RouteId, TripId, VehicleId};
use crate::model::{BatchKind, BatchStatus};

/// An upload to be stored.
#[derive(Debug, Clone)]
pub struct NewBatch {
    /// The route; it exists.
    pub route_id: RouteId,
    /// The key of idempotency within the route.
    pub id: BatchId,
    /// The vehicle.
    pub vehicle_id: VehicleId,
    /// The trip.
    pub trip_id: TripId,
    /// What it holds, and its place in its trip.
    pub content: BatchContent,
    /// What validation found odd and accepted.
    pub flags: Vec<String>,
    /// Readings outside the lidars' ranges; `None` of edges.
    pub out_of_range: Option<OutOfRange>,
    /// A JSON object of the sender's own, as its text.
    pub extensions: Option<String>,
    /// The decompressed body as it was sent.
    pub body: Vec<u8>,
    /// When it came in.
    pub received_at: Timestamp,
}

/// Readings of an upload outside the ranges of its lidars.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutOfRange {
    /// Of `range_max` or longer: they count as no return.
    pub above_range_max: i64,
    /// Below `range_min`: they say nothing.
    pub below_range_min: i64,
}

/// What an upload holds, and its place in its trip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BatchContent {
    /// Scans.
    Scans {
        /// 0, 1, 2 … within the trip.
        sequence: i64,
        /// How many.
        scans: i64,
    },
    /// Nodes and edges: they are taken as they arrive.
    Edges,
}

impl BatchContent {
    /// What it holds.
    pub fn kind(self) -> BatchKind {
        match self {
            Self::Scans { .. } => BatchKind::Scans,
            Self::Edges => BatchKind::Edges,
        }
    }

    /// Number of scans.
    pub fn scans(self) -> i64 {
        match self {
            Self::Scans { scans, .. } => scans,
            Self::Edges => 0,
        }
    }
}

/// What became of an upload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Journaled {
    /// Committed to disk.
    Stored,
    /// The same bytes were there already.
    Replayed,
    /// The id is taken by other bytes.
    Conflict,
}

/// An upload.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchRecord {
    /// The key of idempotency within the route.
    pub id: BatchId,
    /// The route.
    pub route_id: RouteId,
    /// The vehicle.
    pub vehicle_id: VehicleId,
    /// The trip.
    pub trip_id: TripId,
    /// What it holds.
    pub kind: BatchKind,
    /// 0, 1, 2 … within the trip; of edges, in the order of arrival.
    pub sequence: i64,
    /// How far it has come.
    pub status: BatchStatus,
    /// Why it has this status, for people.
    pub reason: Option<String>,
    /// What was found odd and accepted.
    pub flags: Vec<String>,
    /// Readings outside the lidars' ranges; `None` of edges, and where they were not counted.
    pub out_of_range: Option<OutOfRange>,
    /// A JSON object of the sender's own, as its text.
    pub extensions: Option<String>,
    /// Number of scans.
    pub scans: i64,
    /// Nodes it added.
    pub nodes_added: i64,
    /// Loop closures it added.
    pub loop_closures: i64,
    /// When it came in.
    pub received_at: Timestamp,
    /// When it was last worked on.
    pub processed_at: Option<Timestamp>,
}

/// Which batches to list.
#[derive(Debug, Clone, Default)]
pub struct BatchFilter {
    /// Only these.
    pub ids: Option<Vec<BatchId>>,
    /// Only this vehicle's.
    pub vehicle_id: Option<VehicleId>,
    /// Only in this state.
    pub status: Option<BatchStatus>,
}

/// A stored upload with its body.
#[derive(Debug, Clone)]
pub struct JournalEntry {
    /// The upload.
    pub batch: BatchRecord,
    /// The decompressed body as it was sent, its checksum verified.
    pub body: Vec<u8>,
}

/// Bodies that were deleted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeletedBodies {
    /// How many.
    pub bodies: u64,
    /// How long they were together, compressed.
    pub bytes: u64,
}
