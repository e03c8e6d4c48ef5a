//! What workers are handed: a job and its route's graph; and what they hand back.

use jiff::Timestamp;

use super::batches::JournalEntry;
use super::edges::{ArchivedClosure, EdgeChange, EdgeRecord};
use super::nodes::{NewIntermediate, NodeChange, NodeWithScan};
use super::routes::RouteSettings;
use crate::calibration::TripCorrections;
use crate::ids::{BatchId, EdgeId, NodeId, RouteId, TripId};
use crate::model::{BatchStatus, Stage};
use crate::store::alert_records::{AcceptedChange, AlertRecord};
use crate::store::clock_faults::ClockFault;
use crate::store::inputs::JobInput;
use crate::store::trip_calibrations::TripCalibrationRecord;

/// A job that this worker holds until the lease ends.
#[derive(Debug, Clone)]
pub struct ClaimedJob {
    /// The job.
    pub job_id: i64,
    /// The fence: a result with another generation is refused.
    pub generation: i64,
    /// How often it was claimed, this time included.
    pub attempts: i64,
    /// The route.
    pub route_id: RouteId,
    /// The trip's batches that are not in the map yet, in sequence: those that could not be
    /// localised before, and this job's own, last. Of a job of edges the vehicle's, in the order of
    /// arrival.
    pub entries: Vec<JournalEntry>,
    /// Whether the first entry is used without its predecessor, which never came or was quarantined.
    /// Gaps between entries show in their sequences.
    pub after_gap: bool,
    /// Whether the batch, with which a process was lost, is tried without earlier batches of its trip
    /// that still wait: it must not go into the map before them.
    pub apart: bool,
    /// When it was claimed: the time of everything that comes of it.
    pub at: Timestamp,
}

impl ClaimedJob {
    /// The job as the journal of inputs has it.
    pub fn input(&self) -> JobInput {
        let entries = self.entries.iter();
        JobInput {
            batches: entries.map(|entry| entry.batch.id.clone()).collect(),
            after_gap: self.after_gap,
            apart: self.apart,
        }
    }
}

/// How one batch ended.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchOutcome {
    /// The batch.
    pub batch_id: BatchId,
    /// Merged, unanchored or quarantined.
    pub status: BatchStatus,
    /// Why, for people.
    pub reason: Option<String>,
    /// What was found odd; joined to the flags that the batch has.
    pub flags: Vec<String>,
    /// Nodes it added.
    pub nodes_added: i64,
    /// Loop closures it added.
    pub loop_closures: i64,
}

/// Everything one job changes, applied in one transaction.
#[derive(Debug, Clone)]
pub struct JobResult {
    /// The job.
    pub job_id: i64,
    /// The fence as it was claimed.
    pub generation: i64,
    /// The route.
    pub route_id: RouteId,
    /// The route's revision that the result was computed from.
    pub base_revision: i64,
    /// How each of the job's batches ended.
    pub outcomes: Vec<BatchOutcome>,
    /// New nodes.
    pub nodes: Vec<NodeWithScan>,
    /// New scans between keyframes, those of one keyframe in the order of time.
    pub intermediate: Vec<NewIntermediate>,
    /// New edges.
    pub edges: Vec<EdgeRecord>,
    /// Nodes that moved or changed their block.
    pub changed_nodes: Vec<NodeChange>,
    /// Edges whose status or block changed.
    pub changed_edges: Vec<EdgeChange>,
    /// Alerts as they are to be, new ones and the next revisions of others.
    pub alerts: Vec<AlertRecord>,
    /// How far the reference has come.
    pub stage: Stage,
    /// What the trip says of its vehicle, by each lidar for which it was estimated.
    pub calibrations: Vec<TripCalibrationRecord>,
    /// What was found of clocks, or has ended.
    pub clock_faults: Vec<ClockFault>,
    /// What was decided of a trip that begins with this job.
    pub trip_start: Option<(TripId, TripStart)>,
    /// What was processed.
    pub input: JobInput,
    /// When.
    pub processed_at: Timestamp,
}

/// What is decided of a trip when its first scans are processed, and never changes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TripStart {
    /// What is corrected in the whole trip.
    pub corrections: TripCorrections,
    /// How far its clock is ahead: subtracted from its stamps, nanoseconds.
    pub clock_ahead_ns: i64,
}

/// Whether a result was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Applied {
    /// Committed.
    Committed,
    /// The lease was lost or the route has moved on; nothing was written.
    Stale,
}

/// A route's graph as a worker loads it.
#[derive(Debug, Clone)]
pub struct RouteGraph {
    /// The route's revision when it was read.
    pub revision: i64,
    /// How far the reference had come.
    pub stage: Stage,
    /// The settings.
    pub settings: RouteSettings,
    /// The lowest id that no node ever had: that of the next new node.
    pub next_node_id: NodeId,
    /// The lowest id that no edge ever had: that of the next new edge.
    pub next_edge_id: EdgeId,
    /// Every active node by id, with its scan and those between it and the next keyframe.
    pub nodes: Vec<NodeWithScan>,
    /// Every edge between two of them, by id.
    pub edges: Vec<EdgeRecord>,
    /// The first [`ARCHIVED_CLOSURES_MAX`](super::ARCHIVED_CLOSURES_MAX) closures with an archived
    /// node, by id: what the residual series begin with.
    pub archived_closures: Vec<ArchivedClosure>,
    /// The version of the map.
    pub map_version: i64,
    /// Every alert, the oldest first.
    pub alerts: Vec<AlertRecord>,
    /// Every change that the map has taken in, in the order of acceptance.
    pub accepted: Vec<AcceptedChange>,
    /// What the newest trips of each vehicle say of each lidar: by vehicle and lidar, the oldest
    /// first.
    pub calibrations: Vec<TripCalibrationRecord>,
    /// The trips whose clock is behind, by name.
    pub clock_faults: Vec<ClockFault>,
}
