//! A route as clients see it.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::model::{Detector, Stage};
use crate::store::{GeoAnchor, RouteCounts, RouteRecord, RouteSettings};

/// A route.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Route)]
pub(super) struct RouteBody {
    /// Chosen by the client.
    #[schema(example = "line-4")]
    id: String,
    /// A name for people.
    #[schema(required)]
    display_name: Option<String>,
    /// The map's place on the Earth.
    #[schema(required)]
    geo_anchor: Option<GeoAnchorBody>,
    /// Whether the reference is still being built.
    stage: Stage,
    /// The version of the map: increases with every accepted change, undo and release.
    map_version: i64,
    /// Increases with every accepted change and undo.
    epoch: i64,
    /// What the route holds.
    counts: RouteCountsBody,
    /// Batches that are not processed yet: 0 once all uploads are.
    pending_batches: i64,
    /// Its settings.
    settings: RouteSettingsBody,
    /// When it was created.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// When it last changed.
    #[schema(value_type = String, format = DateTime)]
    updated_at: Timestamp,
}

/// What a route holds.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = RouteCounts)]
struct RouteCountsBody {
    batches: i64,
    scans: i64,
    nodes: i64,
    edges: i64,
    loop_closures: i64,
    subgraphs: i64,
    vehicles: i64,
    open_alerts: i64,
}

/// A route's settings.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = RouteSettings)]
struct RouteSettingsBody {
    /// The rule that decides whether something changed.
    detector: Detector,
    /// The accepted number of false alerts per lap. A lap is as much driven distance as the route's reference
    /// is long.
    #[schema(exclusive_minimum = 0.0, maximum = 1.0)]
    false_alarm_rate: f64,
    /// How long a batch waits for its predecessor, seconds.
    hold_s: u32,
    /// How far a batch may move nodes of earlier batches, metres. A batch that would move one farther, and
    /// farther than three standard deviations of its pose, is quarantined.
    max_shift_m: f64,
}

/// The place of a route's map frame on the Earth (WGS 84).
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = GeoAnchor)]
pub(super) struct GeoAnchorBody {
    /// Latitude of the origin, degrees.
    #[schema(minimum = -90, maximum = 90)]
    pub latitude: f64,
    /// Longitude of the origin, degrees.
    #[schema(minimum = -180, maximum = 180)]
    pub longitude: f64,
    /// Direction of the map's x axis, degrees clockwise from north.
    #[schema(minimum = 0, maximum = 360)]
    pub heading: f64,
}

impl From<RouteRecord> for RouteBody {
    fn from(route: RouteRecord) -> Self {
        Self {
            id: route.id.to_string(),
            display_name: route.display_name,
            geo_anchor: route.geo_anchor.map(GeoAnchorBody::from),
            stage: route.stage,
            map_version: route.map_version,
            epoch: route.epoch,
            counts: route.counts.into(),
            pending_batches: route.pending_batches,
            settings: route.settings.into(),
            created_at: route.created_at,
            updated_at: route.updated_at,
        }
    }
}

impl From<RouteCounts> for RouteCountsBody {
    fn from(counts: RouteCounts) -> Self {
        Self {
            batches: counts.batches,
            scans: counts.scans,
            nodes: counts.nodes,
            edges: counts.edges,
            loop_closures: counts.loop_closures,
            subgraphs: counts.subgraphs,
            vehicles: counts.vehicles,
            open_alerts: counts.open_alerts,
        }
    }
}

impl From<RouteSettings> for RouteSettingsBody {
    fn from(settings: RouteSettings) -> Self {
        Self {
            detector: settings.detector,
            false_alarm_rate: settings.false_alarm_rate,
            hold_s: settings.hold_s,
            max_shift_m: settings.max_shift_m,
        }
    }
}

impl From<GeoAnchor> for GeoAnchorBody {
    fn from(anchor: GeoAnchor) -> Self {
        Self {
            latitude: anchor.latitude,
            longitude: anchor.longitude,
            heading: anchor.heading,
        }
    }
}
