//! Routes: what their keepers set, and what they hold.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::change::FALSE_ALERTS_PER_LAP;
use crate::ids::RouteId;
use crate::model::{Detector, Stage};

/// The settings of a route.
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
    /// The settings.
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
