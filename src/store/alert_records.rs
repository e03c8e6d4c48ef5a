//! What the store keeps of alerts and of the versions of a map, as values.

use jiff::Timestamp;

pub use crate::change::{
    AcceptedChange, AlertAction, AlertStatus, ChangeKind, Counterpart, Finding, JudgedPasses, Tier,
};
use crate::geometry::Vector2;
use crate::ids::{AlertId, EdgeId, RouteId, StampNs, VehicleId};
pub use crate::model::SYSTEM;
use crate::model::{Actor, Clearance, DismissReason, VersionAction, VersionState};
pub use crate::render::MapPicture;

use super::records::{EdgeChange, NodeChange};

/// An alert.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertRecord {
    /// Sorts by when it was raised.
    pub id: AlertId,
    /// The route.
    pub route_id: RouteId,
    /// 1 when it is raised, and one more with every change.
    pub revision: i64,
    /// 1 when it is raised, and one more whenever that changes which a decision is about: status, tier,
    /// and the region beyond a tolerance. What an ETag is made of.
    pub decision_revision: i64,
    /// The region as it was with that revision, map frame, metres.
    pub decision_region: Vec<Vector2<f64>>,
    /// Where it is in its life.
    pub status: AlertStatus,
    /// What all observations of the place say together.
    pub evidence: Finding,
    /// The first observation that ever showed it; `evidence.since` is the first of its present episode.
    pub first_seen: StampNs,
    /// Whose observations show the new state, ascending.
    pub vehicles: Vec<VehicleId>,
    /// The passes by its place, and what they saw; `None` for what is no change of state, and for an
    /// alert that has not changed since this program began to keep passes.
    pub passes: Option<JudgedPasses>,
    /// How near it is to the vehicles' way; `None` as `passes`.
    pub clearance: Option<Clearance>,
    /// What the residual of its strongest closure says; `None` without a closure.
    pub residual: Option<AlertResidual>,
    /// The version of the map that it contradicts.
    pub map_version: i64,
    /// Other alerts about the same place.
    pub related: Vec<AlertId>,
    /// When it was raised.
    pub raised_at: Timestamp,
    /// When it last changed.
    pub updated_at: Timestamp,
    /// Every status that it had, the first one first.
    pub history: Vec<HistoryEntry>,
    /// What people and zones have added to it.
    pub handling: Handling,
}

impl AlertRecord {
    /// The revision that clients see: raised by every change of the alert and of its handling.
    pub fn shown_revision(&self) -> i64 {
        self.revision + self.handling.changes
    }
}

/// What people and zones have added to an alert.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Handling {
    /// How often it has changed: counted on top of the alert's revision.
    pub changes: i64,
    /// Who sees to it.
    pub assignee: Option<String>,
    /// How many comments there are.
    pub comments: i64,
    /// Whether a zone mutes it.
    pub muted: Option<Muted>,
}

/// That an alert is muted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Muted {
    /// Until then; `None` for as long as the zone is there.
    pub until: Option<Timestamp>,
}

/// A closure's place in the residual series of its sub-graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlertResidual {
    /// The closure.
    pub edge_id: EdgeId,
    /// What it added to the optimum F (paper: ΔF).
    pub delta_f: f64,
    /// The paper's threshold on ΔF; `None` while its series warms up.
    pub threshold: Option<f64>,
    /// ΔF over the threshold; `None` while its series warms up.
    pub ratio: Option<f64>,
    /// The probability of a ΔF this large without a change.
    pub p_value: f64,
    /// Whether the paper's rule calls it a contradiction.
    pub seed_rule: bool,
}

/// A status that an alert took.
#[derive(Debug, Clone, PartialEq)]
pub struct HistoryEntry {
    /// From then on.
    pub status: AlertStatus,
    /// When.
    pub at: Timestamp,
    /// Who: a name, or [`SYSTEM`].
    pub by: String,
    /// Why, for people.
    pub note: Option<String>,
    /// Why it was dismissed, where somebody says so.
    pub reason: Option<DismissReason>,
}

/// Which alerts to list; every condition that is given holds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AlertFilter {
    /// Of this route.
    pub route_id: Option<RouteId>,
    /// Of one of these routes.
    pub among: Option<Vec<RouteId>>,
    /// In this state.
    pub status: Option<AlertStatus>,
    /// Of this kind.
    pub kind: Option<ChangeKind>,
    /// Of this tier.
    pub tier: Option<Tier>,
    /// Changed at this time or later.
    pub since: Option<Timestamp>,
    /// Located in this rectangle of the map frame: lowest x, lowest y, highest x, highest y,
    /// metres, borders included.
    pub bbox: Option<[f64; 4]>,
    /// At least this confident.
    pub min_confidence: Option<f64>,
    /// Whose new state this vehicle saw.
    pub vehicle_id: Option<VehicleId>,
    /// This near to the vehicles' way.
    pub blocking: Option<Clearance>,
    /// Muted, or not.
    pub muted: Option<bool>,
}

/// Which time, and whose alerts.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportScope {
    /// From then on …
    pub since: Timestamp,
    /// … and before that.
    pub until: Timestamp,
    /// Of this route; `None` for all.
    pub route_id: Option<RouteId>,
    /// Most entries of a list.
    pub limit: u32,
}

/// Something that happened to an alert.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlertEvent {
    /// 1, 2, … over all routes, in the order of commits; gaps are possible.
    pub sequence: i64,
    /// The alert.
    pub alert_id: AlertId,
    /// The alert's revision after it; 1 is the raising.
    pub revision: i64,
    /// When.
    pub at: Timestamp,
    /// Whether what a decision is about has changed: status, kind, tier or region.
    pub is_decision: bool,
}

/// Everything that one decision changes, applied in one transaction. It is about one alert, or accepts
/// several of one route at once.
#[derive(Debug, Clone)]
pub struct Decision {
    /// The route's revision that it was computed from.
    pub base_revision: i64,
    /// What was decided.
    pub action: AlertAction,
    /// By whom.
    pub actor: Actor,
    /// The alerts as they are to be: the revision of each one more than before, its history one longer;
    /// all with the same time of their last change.
    pub alerts: Vec<AlertRecord>,
    /// What happens to the map.
    pub map: Option<MapDecision>,
}

/// What accepting alerts, or taking that back for one, does to a route's map: its next version.
#[derive(Debug, Clone)]
pub struct MapDecision {
    /// Whether changes are taken in or one is taken back.
    pub accepted: AcceptanceChange,
    /// Nodes that moved, or changed their block or part.
    pub changed_nodes: Vec<NodeChange>,
    /// Edges whose residual, status or block changed.
    pub changed_edges: Vec<EdgeChange>,
    /// The map as it was before.
    pub superseded: MapPicture,
    /// How far nodes moved at most, metres.
    pub max_displacement_m: f64,
}

/// How the set of accepted changes changes.
#[derive(Debug, Clone)]
pub enum AcceptanceChange {
    /// The changes of the alerts are taken into the map, in their order.
    Added(Vec<Acceptance>),
    /// The alert's change is taken out of it again.
    Removed,
}

/// An accepted change with what takes it back.
#[derive(Debug, Clone, PartialEq)]
pub struct Acceptance {
    /// The change.
    pub change: AcceptedChange,
    /// What an undo restores; opaque to the store.
    pub undo: Vec<u8>,
}

/// Whether a decision was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decided {
    /// Committed.
    Committed,
    /// The route or the alert has moved on; nothing was written.
    Stale,
}

/// A version of a route's map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapVersionRecord {
    /// 1 for the first map; raised by every acceptance and every undo.
    pub version: i64,
    /// The epoch that it belongs to.
    pub epoch: i64,
    /// When it began.
    pub created_at: Timestamp,
    /// When another one followed; `None` for the present one.
    pub superseded_at: Option<Timestamp>,
    /// What began it; `None` for the first.
    pub cause: Option<VersionCause>,
    /// How far what began it moved nodes at most, metres; `None` where nobody measured it.
    pub max_displacement_m: Option<f64>,
    /// When it was released, by whom and why; `None` if it never was.
    pub released: Option<VersionRelease>,
    /// When it was withdrawn after its release.
    pub retired_at: Option<Timestamp>,
    /// SHA-256 of its PGM; `None` for the present one, which still grows.
    pub sha256: Option<[u8; 32]>,
}

impl MapVersionRecord {
    /// Where it is in its life: one that ended without a release is as good as retired.
    pub fn state(&self) -> VersionState {
        match (self.superseded_at, &self.released, self.retired_at) {
            (None, ..) => VersionState::Draft,
            (Some(_), Some(_), None) => VersionState::Released,
            _ => VersionState::Retired,
        }
    }
}

/// What began a version.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VersionCause {
    /// The alert that was decided about; `None` for a release.
    pub alert_id: Option<AlertId>,
    /// What was done.
    pub action: VersionAction,
    /// Who did it; `None` where nobody wrote it down.
    pub by: Option<String>,
    /// Why, for people.
    pub note: Option<String>,
}

/// A version's release for vehicles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VersionRelease {
    /// When.
    pub at: Timestamp,
    /// Who released it.
    pub by: String,
    /// Why, for people.
    pub note: Option<String>,
}

/// Everything that the release of a route's present version changes, applied in one transaction.
#[derive(Debug, Clone)]
pub struct Release {
    /// The route.
    pub route_id: RouteId,
    /// Its present version.
    pub version: i64,
    /// The route's revision that the picture was drawn from.
    pub base_revision: i64,
    /// By whom.
    pub actor: Actor,
    /// When, by whom and why.
    pub release: VersionRelease,
    /// The map as it is.
    pub picture: MapPicture,
}
