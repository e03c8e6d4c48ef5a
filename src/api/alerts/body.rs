//! An alert as clients see it.

use axum::Json;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::passes::PassCountsBody;
use super::sentence::{summary, title};
use super::size::Size;
use super::suspect_body::SuspectBody;
use crate::api::types::timestamp;
use crate::change::Counterpart;
use crate::geometry::Vector2;
use crate::model::{AlertAction, AlertStatus, ChangeKind, Clearance, DismissReason, Tier};
use crate::pipeline::is_allowed;
use crate::scan::HeightBand;
use crate::store::{AlertRecord, AlertResidual, HistoryEntry};

/// A place where the world contradicts a route's map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Alert, example = json!({
    "id": "019aa000-0000-7000-8000-000000000001", "route_id": "line-4", "revision": 17, "decision_revision": 3,
    "kind": "appeared", "status": "open", "tier": "confirmed", "actions": ["acknowledge", "accept", "dismiss"],
    "title": "Appeared: about 0.4 × 0.4 m", "summary": "Something about 0.4 × 0.4 m stands where 7 earlier passes saw free space, since 06:00; seen by agv-07 in 2 of 2 passes.",
    "size": {"length": 0.4, "width": 0.4}, "blocking": "near",
    "passes": {"before": {"saw_free": 7, "saw_occupied": 0, "could_not_see": 1}, "since": {"saw_free": 0, "saw_occupied": 2, "could_not_see": 0}},
    "confidence": 0.998, "location": {"x": 12.31, "y": 4.02, "sigma": 0.06},
    "region": [[12.1, 3.8], [12.5, 3.8], [12.5, 4.2], [12.1, 4.2]], "counterpart": null, "shift": null, "suspect": null, "bands": [],
    "edge_ids": [881, 882], "node_ids": [41, 612], "vehicle_ids": ["agv-07"], "trip_ids": ["2026-11-20-a"],
    "views": 9, "laps": 2,
    "residual": {"edge_id": 881, "delta_f": 0.031, "threshold": 0.0022, "ratio": 14.1, "p_value": 1e-9, "seed_rule": true},
    "first_seen": "2026-11-20T06:00:00Z", "since": "2026-11-20T06:00:00Z", "last_seen": "2026-11-20T07:30:00Z", "until": null,
    "raised_at": "2026-11-20T06:00:09Z", "updated_at": "2026-11-20T07:30:08Z", "map_version": 1, "related": [],
    "assignee": null, "comments": 0, "muted": false, "muted_until": null,
    "history": [{"status": "open", "at": "2026-11-20T06:00:09Z", "by": "system", "note": null, "reason": null}]
}))]
pub(in crate::api) struct AlertBody {
    /// UUID of version 7: sorts by when the alert was raised.
    #[schema(format = "uuid")]
    pub id: String,
    /// The route.
    pub route_id: String,
    /// Increases with every change of the alert, `assignee`, `comments` and `muted` included.
    revision: i64,
    /// Increases when what a decision is about changes: the status, the tier, or the region by more than
    /// 0.25 m; not with further evidence. In quotes it is the ETag that `If-Match` is compared with.
    decision_revision: i64,
    /// What changed.
    kind: ChangeKind,
    /// Whether it awaits a decision, and what was decided.
    status: AlertStatus,
    /// How well it is supported.
    tier: Tier,
    /// The actions that are possible now.
    actions: Vec<AlertAction>,
    /// What happened, in a few words for people.
    title: String,
    /// What happened, where, since when, and which vehicles observed it, in one sentence for people. Times
    /// are UTC.
    summary: String,
    /// The size of its region; null without a region.
    #[schema(required)]
    size: Option<Size>,
    /// How near the change is to the path that vehicles took before it; null for alerts that are not about
    /// the change of a place, and for old ones, not updated since the service began to compute it.
    #[schema(required)]
    blocking: Option<Clearance>,
    /// How many passes observed what at the place, before the change and since; null under the same conditions
    /// as `blocking`.
    #[schema(required)]
    passes: Option<PassCountsBody>,
    /// The probability that the alert is true.
    #[schema(minimum = 0, maximum = 1)]
    confidence: f64,
    /// Where it is.
    location: LocationBody,
    /// A simple polygon around what changed, map frame, metres, counter-clockwise, not closed.
    #[schema(value_type = Vec<Vec<f64>>)]
    region: Vec<[f64; 2]>,
    /// The other side of the same event, if a door or a moved object shows two; null if none is known.
    #[schema(required)]
    counterpart: Option<CounterpartBody>,
    /// For a `map_mismatch` that a single shift explains: the vector that would move what the pass observed
    /// onto the map, map frame, metres. Null for all other alerts.
    #[schema(required)]
    shift: Option<ShiftBody>,
    /// For a `vehicle_suspect`: the vehicle's faults, and the changes that they explain. Null for all other
    /// alerts, and for those raised before the service recorded it.
    #[schema(required)]
    suspect: Option<SuspectBody>,
    /// The height bands that show it; empty if it was observed by lidars that scan a single plane.
    bands: Vec<AlertBandBody>,
    /// The loop closures whose scans disagree at the place.
    edge_ids: Vec<i64>,
    /// The nodes whose scans show the old or the new state; for a `map_mismatch`, those of the segment that
    /// does not fit, which `region` covers.
    node_ids: Vec<i64>,
    /// The vehicles that observed the new state.
    vehicle_ids: Vec<String>,
    /// The trips that observed the new state.
    trip_ids: Vec<String>,
    /// How many scans show the new state.
    views: u64,
    /// How many passes since the change observed the new state.
    laps: u64,
    /// The residual of its strongest loop closure; null without one.
    #[schema(required)]
    residual: Option<AlertResidualBody>,
    /// The first observation that ever showed it.
    #[schema(value_type = String, format = DateTime)]
    first_seen: Timestamp,
    /// The first observation of its present episode: later than `first_seen` if it came back.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
    /// The last observation that shows it.
    #[schema(value_type = String, format = DateTime)]
    last_seen: Timestamp,
    /// The first observation that shows the old state again; null while the new state lasts.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    until: Option<Timestamp>,
    /// When the service raised it.
    #[schema(value_type = String, format = DateTime)]
    raised_at: Timestamp,
    /// When it last changed.
    #[schema(value_type = String, format = DateTime)]
    updated_at: Timestamp,
    /// The version of the map that it contradicts.
    map_version: i64,
    /// Ids of other alerts about the same place.
    related: Vec<String>,
    /// Who is responsible for it; null if nobody is.
    #[schema(required)]
    assignee: Option<String>,
    /// The number of comments.
    comments: i64,
    /// Whether a zone mutes it: it is not sent to webhooks and does not count among the open alerts.
    muted: bool,
    /// When muting ends by itself; null if it does not, or if the alert is not muted.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    muted_until: Option<Timestamp>,
    /// Every status that it has had, the oldest first.
    history: Vec<HistoryBody>,
}

/// A height band that shows an alert.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertBand)]
pub(super) struct AlertBandBody {
    /// Its lower end, metres above the floor.
    from: f64,
    /// Its upper end, metres above the floor.
    to: f64,
}

/// A place in the map frame.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertLocation)]
pub(super) struct LocationBody {
    /// Metres.
    x: f64,
    /// Metres.
    y: f64,
    /// Standard deviation of x and of y, metres.
    sigma: f64,
}

/// The other side of one event: an object that left one place and appeared at another.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertCounterpart)]
struct CounterpartBody {
    /// The change on the other side.
    kind: ChangeKind,
    /// A simple polygon around it, map frame, metres, counter-clockwise, not closed.
    #[schema(value_type = Vec<Vec<f64>>)]
    region: Vec<[f64; 2]>,
}

/// A vector in the map frame.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertShift)]
pub(super) struct ShiftBody {
    /// Metres.
    x: f64,
    /// Metres.
    y: f64,
}

/// A loop closure in the residual series of its sub-graph.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertResidual)]
struct AlertResidualBody {
    /// The loop closure.
    edge_id: i64,
    /// The increase of the optimum F that it caused.
    delta_f: f64,
    /// The paper's threshold; null until the series has converged.
    #[schema(required)]
    threshold: Option<f64>,
    /// `delta_f` divided by the threshold; null until the series has converged.
    #[schema(required)]
    ratio: Option<f64>,
    /// The probability of a `delta_f` this large without a change.
    p_value: f64,
    /// Whether it is a contradiction by the paper's rule.
    seed_rule: bool,
}

/// A status that an alert has had.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertHistoryEntry)]
struct HistoryBody {
    /// The status.
    status: AlertStatus,
    /// When it began.
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// Who caused it: a name, or `system`.
    by: String,
    /// Why, for people.
    #[schema(required)]
    note: Option<String>,
    /// Why it was dismissed; null if no reason was given, and for every other status.
    #[schema(required)]
    reason: Option<DismissReason>,
}

/// The ETag of an alert.
pub(super) fn etag(alert: &AlertRecord) -> String {
    format!("\"{}\"", alert.decision_revision)
}

/// The answer with an alert. It is never 304: the rest of an alert changes under the same ETag.
pub(super) fn with_etag(alert: AlertRecord) -> Response {
    let headers = [
        (header::ETAG, etag(&alert)),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ];
    (headers, Json(AlertBody::from(alert))).into_response()
}

/// An alert as this interface shows it: a JSON object.
///
/// # Errors
/// If it does not serialise.
pub fn alert_text(alert: AlertRecord) -> Result<String, serde_json::Error> {
    serde_json::to_string(&AlertBody::from(alert))
}

/// The actions that are possible now.
fn allowed_actions(alert: &AlertRecord) -> Vec<AlertAction> {
    let all = AlertAction::ALL.into_iter();
    all.filter(|action| is_allowed(alert, *action)).collect()
}

/// Corners as arrays of x and y.
pub(super) fn corners(polygon: &[Vector2<f64>]) -> Vec<[f64; 2]> {
    polygon.iter().map(|corner| [corner.x, corner.y]).collect()
}

impl LocationBody {
    pub(super) fn of(alert: &AlertRecord) -> Self {
        Self {
            x: alert.evidence.location.x,
            y: alert.evidence.location.y,
            sigma: alert.evidence.sigma_m,
        }
    }
}

impl From<AlertRecord> for AlertBody {
    fn from(alert: AlertRecord) -> Self {
        let actions = allowed_actions(&alert);
        let location = LocationBody::of(&alert);
        let size = Size::of(&alert.evidence.region);
        let (title, summary) = (title(&alert, size), summary(&alert, size));
        let revision = alert.shown_revision();
        let evidence = alert.evidence;
        Self {
            id: alert.id.to_string(),
            route_id: alert.route_id.to_string(),
            revision,
            decision_revision: alert.decision_revision,
            kind: evidence.kind,
            status: alert.status,
            tier: evidence.tier,
            actions,
            title,
            summary,
            size,
            blocking: alert.clearance,
            passes: alert.passes.as_ref().map(PassCountsBody::from),
            confidence: evidence.confidence,
            location,
            region: corners(&evidence.region),
            counterpart: evidence.counterpart.map(CounterpartBody::from),
            shift: evidence.shift.map(ShiftBody::from),
            suspect: evidence.suspect.map(SuspectBody::from),
            bands: evidence.bands.iter().map(AlertBandBody::from).collect(),
            edge_ids: evidence.edges.iter().map(|id| id.0).collect(),
            node_ids: evidence.nodes.iter().map(|id| id.0).collect(),
            vehicle_ids: alert.vehicles.iter().map(ToString::to_string).collect(),
            trip_ids: evidence.trips.iter().map(ToString::to_string).collect(),
            views: evidence.views as u64,
            laps: evidence.laps as u64,
            residual: alert.residual.map(AlertResidualBody::from),
            first_seen: timestamp(alert.first_seen),
            since: timestamp(evidence.since),
            last_seen: timestamp(evidence.last_seen),
            until: evidence.until.map(timestamp),
            raised_at: alert.raised_at,
            updated_at: alert.updated_at,
            map_version: alert.map_version,
            related: alert.related.iter().map(ToString::to_string).collect(),
            assignee: alert.handling.assignee,
            comments: alert.handling.comments,
            muted: alert.handling.muted.is_some(),
            muted_until: alert.handling.muted.and_then(|muted| muted.until),
            history: alert.history.into_iter().map(HistoryBody::from).collect(),
        }
    }
}

impl From<&HeightBand> for AlertBandBody {
    fn from(band: &HeightBand) -> Self {
        Self {
            from: band.from_m,
            to: band.to_m,
        }
    }
}

impl From<Counterpart> for CounterpartBody {
    fn from(counterpart: Counterpart) -> Self {
        Self {
            kind: counterpart.kind,
            region: corners(&counterpart.region),
        }
    }
}

impl From<Vector2<f64>> for ShiftBody {
    fn from(shift: Vector2<f64>) -> Self {
        Self {
            x: shift.x,
            y: shift.y,
        }
    }
}

impl From<AlertResidual> for AlertResidualBody {
    fn from(residual: AlertResidual) -> Self {
        Self {
            edge_id: residual.edge_id.0,
            delta_f: residual.delta_f,
            threshold: residual.threshold,
            ratio: residual.ratio,
            p_value: residual.p_value,
            seed_rule: residual.seed_rule,
        }
    }
}

impl From<HistoryEntry> for HistoryBody {
    fn from(entry: HistoryEntry) -> Self {
        Self {
            status: entry.status,
            at: entry.at,
            by: entry.by,
            note: entry.note,
            reason: entry.reason,
        }
    }
}
