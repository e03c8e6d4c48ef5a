//! Removals of uploads from a route: requests, what they remove, and results, as values.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::alert_records::AlertRecord;
use super::records::{EdgeChange, NodeChange};
use crate::ids::{BatchId, EdgeId, NodeId, OperationId, RouteId, TripId, VehicleId};

/// Which uploads are meant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Meant {
    /// Batches by their ids.
    Batches(Vec<BatchId>),
    /// Everything of some trips.
    Trips(Vec<TripId>),
    /// Everything that a vehicle sent, if `since` is given from then on.
    Vehicle {
        /// The vehicle.
        id: VehicleId,
        /// By when the service received it.
        since: Option<Timestamp>,
    },
}

/// What somebody wants to have removed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemovalRequest {
    /// Which uploads.
    pub meant: Meant,
    /// Whether the result only says what would be removed.
    pub dry_run: bool,
    /// Whether the stored bodies are deleted too.
    pub erase: bool,
    /// Why, for people.
    pub note: Option<String>,
}

/// What was removed, or would be.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RemovalResult {
    /// Uploads.
    pub batches: u64,
    /// Nodes.
    pub nodes: u64,
    /// Edges, including those of other uploads that end at the nodes.
    pub edges: u64,
    /// Alerts that it raises, resolves, or changes the evidence of.
    pub alerts: u64,
    /// How far the rest of the map moves, at most, metres.
    pub moved_m: f64,
    /// Whether the map was made anew as if the uploads had never come.
    #[serde(default)]
    pub rebuilt: bool,
    /// Why it was not, for people.
    #[serde(default)]
    pub not_rebuilt_because: Option<String>,
}

/// The uploads that a request means, with what they hold of the graph.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Removable {
    /// In the order of arrival; none was removed before.
    pub batches: Vec<BatchId>,
    /// Their trips.
    pub trips: Vec<TripId>,
    /// Their nodes, ascending.
    pub nodes: Vec<NodeId>,
    /// Their edges and those of others that end at their nodes, ascending.
    pub edges: Vec<EdgeId>,
}

/// A removal as it was computed.
#[derive(Debug, Clone, PartialEq)]
pub struct Removal {
    /// The operation that ends with it.
    pub operation: OperationId,
    /// The route.
    pub route_id: RouteId,
    /// The route's revision that it was computed from.
    pub base_revision: i64,
    /// What is removed.
    pub removable: Removable,
    /// Nodes that stay and change.
    pub changed_nodes: Vec<NodeChange>,
    /// Edges that stay and change.
    pub changed_edges: Vec<EdgeChange>,
    /// Alerts that are new or change.
    pub alerts: Vec<AlertRecord>,
    /// Why the uploads are not in the map any more, for people.
    pub reason: String,
    /// Whether the stored bodies are deleted too.
    pub erase: bool,
    /// What the operation's result says.
    pub result: RemovalResult,
    /// Whether the operation ends with it; otherwise the map is made anew first.
    pub ends: bool,
    /// When.
    pub at: Timestamp,
}
