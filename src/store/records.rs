//! What the store keeps, as values.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::alert_records::{AcceptedChange, AlertRecord};
use super::clock_faults::ClockFault;
use super::inputs::JobInput;
use super::vehicles::TripCalibrationRecord;
use crate::calibration::TripCorrections;
use crate::change::FALSE_ALERTS_PER_LAP;
use crate::geometry::{Information, Pose2, PoseSigma};
use crate::graph::{EdgeKind, EdgeStatus};
use crate::ids::{BatchId, EdgeId, LidarId, NodeId, RouteId, StampNs, TripId, VehicleId};
use crate::mapping::LOST_DRIFT_M;
use crate::model::{BatchKind, BatchStatus, Detector, Stage};
use crate::scan::{CodecError, LaserScan, decode_scan};

/// What a route's keeper can set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RouteSettings {
    /// The rule.
    pub detector: Detector,
    /// False alerts per lap that are accepted, in (0, 1]. A lap is as much driven way as the
    /// route's reference is long.
    pub false_alarm_rate: f64,
    /// How long a batch waits for its predecessor before it is used on its own, seconds.
    pub hold_s: u32,
    /// How far a batch may move what others have mapped, metres.
    pub max_shift_m: f64,
}

impl Default for RouteSettings {
    fn default() -> Self {
        Self {
            detector: Detector::Fused,
            false_alarm_rate: FALSE_ALERTS_PER_LAP,
            hold_s: 600,
            max_shift_m: 0.02,
        }
    }
}

/// Where a route's map frame lies on the Earth (WGS 84, degrees; heading of the x axis clockwise
/// from north).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeoAnchor {
    /// Degrees, −90 to 90.
    pub latitude: f64,
    /// Degrees, −180 to 180.
    pub longitude: f64,
    /// Degrees, 0 to 360.
    pub heading: f64,
}

/// What a route holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RouteCounts {
    /// Uploads accepted.
    pub batches: i64,
    /// Scans in them.
    pub scans: i64,
    /// Nodes of the pose graph.
    pub nodes: i64,
    /// Edges of the pose graph.
    pub edges: i64,
    /// Edges that close a loop.
    pub loop_closures: i64,
    /// Blocks of the pose graph that hold a loop closure.
    pub subgraphs: i64,
    /// Vehicles that uploaded.
    pub vehicles: i64,
    /// Alerts not yet decided.
    pub open_alerts: i64,
}

/// A route.
#[derive(Debug, Clone, PartialEq)]
pub struct RouteRecord {
    /// Chosen by the client.
    pub id: RouteId,
    /// For people.
    pub display_name: Option<String>,
    /// Where the map lies on the Earth.
    pub geo_anchor: Option<GeoAnchor>,
    /// What its keeper set.
    pub settings: RouteSettings,
    /// How far the reference has come.
    pub stage: Stage,
    /// Raised by every accepted change.
    pub map_version: i64,
    /// Raised by every accepted change.
    pub epoch: i64,
    /// Raised by every result that is applied: the fence of optimistic work.
    pub revision: i64,
    /// What it holds.
    pub counts: RouteCounts,
    /// Batches that still wait to be processed.
    pub pending_batches: i64,
    /// When it was first put.
    pub created_at: Timestamp,
    /// When it last changed.
    pub updated_at: Timestamp,
}

/// What a PUT of a route changes; `None` leaves a field as it is.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RouteUpdate {
    /// For people.
    pub display_name: Option<String>,
    /// Where the map lies on the Earth.
    pub geo_anchor: Option<GeoAnchor>,
    /// The settings.
    pub settings: SettingsUpdate,
    /// Change the route only if it is still this one, and do not create it.
    pub expected: Option<RouteEdition>,
}

/// What of a route's settings a PUT changes; `None` leaves a field as it is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SettingsUpdate {
    /// As [`RouteSettings::detector`]; refused once the route has batches.
    pub detector: Option<Detector>,
    /// As [`RouteSettings::false_alarm_rate`].
    pub false_alarm_rate: Option<f64>,
    /// As [`RouteSettings::hold_s`].
    pub hold_s: Option<u32>,
    /// As [`RouteSettings::max_shift_m`].
    pub max_shift_m: Option<f64>,
}

/// What changes with every result of a route and with every edit of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RouteEdition {
    /// As [`RouteRecord::revision`].
    pub revision: i64,
    /// As [`RouteRecord::updated_at`].
    pub updated_at: Timestamp,
}

impl RouteRecord {
    /// The route as it was read.
    pub fn edition(&self) -> RouteEdition {
        RouteEdition {
            revision: self.revision,
            updated_at: self.updated_at,
        }
    }
}

/// An upload to be stored.
#[derive(Debug, Clone)]
pub struct NewBatch {
    /// The route; it exists.
    pub route_id: RouteId,
    /// The key of idempotency within the route.
    pub id: BatchId,
    /// Who drove.
    pub vehicle_id: VehicleId,
    /// Which drive.
    pub trip_id: TripId,
    /// What it holds, and its place in its trip.
    pub content: BatchContent,
    /// What was noticed while it was validated.
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
    /// Who drove.
    pub vehicle_id: VehicleId,
    /// Which drive.
    pub trip_id: TripId,
    /// What it holds.
    pub kind: BatchKind,
    /// 0, 1, 2 … within the trip; of edges, in the order of arrival.
    pub sequence: i64,
    /// Where it is on its way.
    pub status: BatchStatus,
    /// Why it is there, for people.
    pub reason: Option<String>,
    /// What was noticed.
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
    /// anchored before, and this job's own, last. Of a job of edges the vehicle's, in the order of
    /// arrival.
    pub entries: Vec<JournalEntry>,
    /// Whether the predecessor of the first entry never came, or was quarantined, and it is used
    /// on its own. Gaps further on show in the entries' sequences.
    pub after_gap: bool,
    /// Whether batches of the trip wait that this one, which a process was lost with, is tried
    /// without: it must not go into the map before them.
    pub apart: bool,
    /// When it was claimed: the time that whatever comes of it bears.
    pub at: Timestamp,
}

impl ClaimedJob {
    /// What the journal of inputs says of it.
    pub fn input(&self) -> JobInput {
        let entries = self.entries.iter();
        JobInput {
            batches: entries.map(|entry| entry.batch.id.clone()).collect(),
            after_gap: self.after_gap,
            apart: self.apart,
        }
    }
}

/// A node as it is stored. Scans are the bytes of [`crate::scan::encode_scan`].
#[derive(Debug, Clone, PartialEq)]
pub struct NodeRecord {
    /// Unique within the route.
    pub id: NodeId,
    /// The upload it came with.
    pub batch_id: BatchId,
    /// Who drove.
    pub vehicle_id: VehicleId,
    /// Which drive.
    pub trip_id: TripId,
    /// When the scan was taken.
    pub stamp: StampNs,
    /// `map_from_base`.
    pub pose: Pose2,
    /// How uncertain the pose is, relative to the first node that the node hangs together with;
    /// `None` where nothing tells.
    pub sigma: Option<PoseSigma>,
    /// `odom_from_base` as the vehicle sent it.
    pub odom_from_base: Pose2,
    /// Way driven since the trip was last tied to the map, metres; [`LOST_DRIFT_M`] and more where
    /// nothing tells where the node is.
    pub drift_m: f64,
    /// Whether later laps are tied to it.
    pub reference: bool,
    /// Whether it takes part in the optimisation: its drive has not settled, or later laps still
    /// need it.
    pub active: bool,
    /// The block of the graph it lies in; `None` outside every block with a loop closure.
    pub subgraph_id: Option<i64>,
    /// Its place in its trip: 0, 1, 2 …
    pub trip_order: u32,
    /// What the vehicle calls it, if it came with a batch of edges.
    pub client_id: Option<String>,
}

impl NodeRecord {
    /// Whether it is known where the node is: its trip was not lost there.
    pub fn is_localised(&self) -> bool {
        self.drift_m < LOST_DRIFT_M
    }
}

/// A node with its scan.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeWithScan {
    /// The node.
    pub node: NodeRecord,
    /// The bytes of [`crate::scan::encode_scan`]; `None` if it came with a batch of edges.
    pub scan: Option<Vec<u8>>,
    /// Which of the vehicle's lidars took the scan; `None` for its only one.
    pub lidar: Option<LidarId>,
    /// The trip's scans between it and its next keyframe, in the order of time; none of a new
    /// node: a result brings them in [`JobResult::intermediate`].
    pub intermediate: Vec<IntermediateRecord>,
}

/// A scan that was taken after a keyframe and before the next one of its trip, as it is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct IntermediateRecord {
    /// When it was taken.
    pub stamp: StampNs,
    /// Pose of the base in the frame of the keyframe's base.
    pub keyframe_from_base: Pose2,
    /// Pose of the base in the vehicle's own odometry frame.
    pub odom_from_base: Pose2,
    /// The lidar beside that of its keyframe that took it; `None` for a scan of the keyframe's.
    pub companion: Option<LidarId>,
    /// Whether its points count as the keyframe's; a companion's only.
    pub lends: bool,
    /// The bytes of [`crate::scan::encode_scan`]; `None` where it would repeat the scan before.
    pub scan: Option<Vec<u8>>,
}

impl NodeWithScan {
    /// Its own scan and those behind it that were kept, each with its stamp and `map_from_base`.
    ///
    /// # Errors
    /// [`CodecError`] if one does not decode.
    pub fn decoded_scans(&self) -> Result<Vec<(StampNs, Pose2, LaserScan)>, CodecError> {
        let own = self.scan.as_ref();
        let own = own.map(|scan| (self.node.stamp, self.node.pose, scan));
        let following = self.intermediate.iter().filter_map(|following| {
            let pose = self.node.pose.compose(&following.keyframe_from_base);
            Some((following.stamp, pose, following.scan.as_ref()?))
        });
        let decoded = own.into_iter().chain(following);
        let decoded = decoded.map(|(stamp, pose, scan)| Ok((stamp, pose, decode_scan(scan)?)));
        decoded.collect()
    }
}

/// A new scan between keyframes.
#[derive(Debug, Clone, PartialEq)]
pub struct NewIntermediate {
    /// The keyframe that it follows: a new node or one that is there.
    pub node_id: NodeId,
    /// Its place among those of the keyframe: they go on where those that are there end.
    pub place: u32,
    /// The scan.
    pub scan: IntermediateRecord,
}

/// Where a trip was when a scan was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrajectoryPose {
    /// The keyframe that the scan is, or moves with.
    pub node_id: NodeId,
    /// Whether the scan is the keyframe's own, or one between keyframes.
    pub is_keyframe: bool,
    /// When the scan was taken.
    pub stamp: StampNs,
    /// `map_from_base`.
    pub pose: Pose2,
}

/// What two matched scans say beside the estimate that is optimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosureRecord {
    /// The all-points estimate of `from_from_to`; never optimised in fused mode.
    pub all_points_measurement: Pose2,
    /// Its information.
    pub all_points_information: Information,
    /// Share of the points with a counterpart.
    pub overlap: f64,
    /// Share of the counterparts that agree.
    pub inlier_share: f64,
    /// Root mean square distance of the agreeing points, metres.
    pub rmse_m: f64,
    /// eᵀΩe of the all-points estimate at the optimum when it was inserted.
    pub all_points_residual: f64,
}

/// Which edges to list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EdgeFilter {
    /// Only of this kind.
    pub kind: Option<EdgeKind>,
    /// Only in this state.
    pub status: Option<EdgeStatus>,
}

/// An edge as it is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeRecord {
    /// Unique within the route.
    pub id: EdgeId,
    /// Its older node.
    pub from: NodeId,
    /// Its newer node.
    pub to: NodeId,
    /// What made it.
    pub kind: EdgeKind,
    /// Whether it is optimised.
    pub status: EdgeStatus,
    /// The upload it came with.
    pub batch_id: BatchId,
    /// `from_from_to`, as optimised.
    pub measurement: Pose2,
    /// Of the measurement.
    pub information: Information,
    /// eᵀΩe at the poses of its nodes; not stored, but told of them when the edge is read.
    pub residual: f64,
    /// The block of the graph it lies in; `None` for bridges.
    pub subgraph_id: Option<i64>,
    /// What a loop closure added to the optimum F when it was inserted (paper: ΔF); `None` for
    /// odometry.
    pub delta_f: Option<f64>,
    /// For loop closures between scans.
    pub closure: Option<ClosureRecord>,
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
    /// What was noticed; joined to the flags it has.
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
    /// What the trip says of its vehicle by each of its lidars that was asked.
    pub calibrations: Vec<TripCalibrationRecord>,
    /// What was found of clocks, or has ended.
    pub clock_faults: Vec<ClockFault>,
    /// What was decided of a trip that begins.
    pub trip_start: Option<(TripId, TripStart)>,
    /// What was processed.
    pub input: JobInput,
    /// When.
    pub processed_at: Timestamp,
}

/// What is decided of a trip when its first scans are processed, and the same to its end.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TripStart {
    /// What is corrected while it is driven.
    pub corrections: TripCorrections,
    /// What is taken from its stamps because its clock is ahead, nanoseconds.
    pub clock_ahead_ns: i64,
}

/// The part of a node that a solve or a decision changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeChange {
    /// The node.
    pub id: NodeId,
    /// `map_from_base`.
    pub pose: Pose2,
    /// As [`NodeRecord::sigma`].
    pub sigma: Option<PoseSigma>,
    /// The block of the graph it lies in.
    pub subgraph_id: Option<i64>,
    /// As [`NodeRecord::drift_m`].
    pub drift_m: f64,
    /// Whether later laps are tied to it.
    pub reference: bool,
    /// Whether it takes part in the optimisation.
    pub active: bool,
}

/// The part of an edge that a solve changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeChange {
    /// The edge.
    pub id: EdgeId,
    /// Whether it is optimised.
    pub status: EdgeStatus,
    /// The block of the graph it lies in.
    pub subgraph_id: Option<i64>,
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
    /// What it was read at.
    pub revision: i64,
    /// How far the reference had come.
    pub stage: Stage,
    /// The settings.
    pub settings: RouteSettings,
    /// The lowest id that no node ever had; new nodes take ids from here on.
    pub next_node_id: NodeId,
    /// The lowest id that no edge ever had; new edges take ids from here on.
    pub next_edge_id: EdgeId,
    /// Every active node by id, with its scan and those that follow it.
    pub nodes: Vec<NodeWithScan>,
    /// Every edge between two of them, by id.
    pub edges: Vec<EdgeRecord>,
    /// Of the closures between other nodes the first [`SETTLED_CLOSURES_MAX`], by id: what the
    /// series of residuals began with.
    pub settled_closures: Vec<SettledClosure>,
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

/// Most closures that are remembered in a worker's map after their nodes have left it.
pub const SETTLED_CLOSURES_MAX: usize = 1_000;

/// A closure of which a node has left the active graph.
#[derive(Debug, Clone, PartialEq)]
pub struct SettledClosure {
    /// The edge.
    pub id: EdgeId,
    /// Its older node.
    pub from: NodeId,
    /// Its newer node.
    pub to: NodeId,
    /// The block of the graph it lay in last.
    pub subgraph_id: Option<i64>,
    /// What it added to the optimum F when it was inserted (paper: ΔF).
    pub delta_f: f64,
    /// Who drove the node with the larger id.
    pub vehicle_id: VehicleId,
    /// Whether it came as an edge, and no two scans were matched for it.
    pub given: bool,
}

/// Bodies that were deleted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeletedBodies {
    /// How many.
    pub bodies: u64,
    /// How long they were together, compressed.
    pub bytes: u64,
}
