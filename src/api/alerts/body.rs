//! An alert as clients see it.

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
pub(super) struct AlertBody {
    /// UUID of version 7: sorts by when the alert was raised.
    #[schema(format = "uuid")]
    pub id: String,
    /// The route.
    pub route_id: String,
    /// Raised by every change of the alert, and of `assignee`, `comments` and `muted`.
    revision: i64,
    /// Raised when that changes which a decision is about: status, tier, or the region by more than
    /// 0.25 m; not by further evidence. In quotes it is the ETag that `If-Match` is compared with.
    decision_revision: i64,
    /// What changed.
    kind: ChangeKind,
    /// What became of it.
    status: AlertStatus,
    /// How far it is to be believed.
    tier: Tier,
    /// What can be done with it now.
    actions: Vec<AlertAction>,
    /// What happened, in a few words for people.
    title: String,
    /// What happened, where, since when and who saw it, in one sentence for people. Times are UTC.
    summary: String,
    /// How large its region is; null without a region.
    #[schema(required)]
    size: Option<Size>,
    /// How near it is to the way that vehicles took before it; null for alerts that are about no change
    /// of a place, and for those that have not changed since the service computes it.
    #[schema(required)]
    blocking: Option<Clearance>,
    /// How many passes by the place saw what, before and since; null as `blocking`.
    #[schema(required)]
    passes: Option<PassCountsBody>,
    /// Probability that it is true.
    #[schema(minimum = 0, maximum = 1)]
    confidence: f64,
    /// Where it is.
    location: LocationBody,
    /// A simple polygon round what changed, map frame, metres, counter-clockwise, not closed.
    #[schema(value_type = Vec<Vec<f64>>)]
    region: Vec<[f64; 2]>,
    /// The other side of the same event, as of a door or of something that was moved; null if none
    /// is known.
    #[schema(required)]
    counterpart: Option<CounterpartBody>,
    /// Of a `map_mismatch` that one shift explains: the vector by which what the pass observed there
    /// would have to be moved to lie on the map, map frame, metres. Null for all other alerts.
    #[schema(required)]
    shift: Option<ShiftBody>,
    /// Of a `vehicle_suspect`: what is off, and the changes that it explains. Null for all other
    /// alerts, and for those that were raised before there was such a word.
    #[schema(required)]
    suspect: Option<SuspectBody>,
    /// The height bands that show it; none if it is seen by lidars that look along one plane.
    bands: Vec<AlertBandBody>,
    /// The loop closures whose scans disagree there.
    edge_ids: Vec<i64>,
    /// The nodes whose scans show the old or the new state; of a `map_mismatch` those of the segment
    /// that does not fit, which `region` covers.
    node_ids: Vec<i64>,
    /// The vehicles that saw the new state.
    vehicle_ids: Vec<String>,
    /// The drives that saw the new state.
    trip_ids: Vec<String>,
    /// Scans that show the new state.
    views: u64,
    /// Passes since the change: those by the place that saw the new state.
    laps: u64,
    /// What the residual of its strongest closure says; null without a closure.
    #[schema(required)]
    residual: Option<AlertResidualBody>,
    /// The first look that ever showed it.
    #[schema(value_type = String, format = DateTime)]
    first_seen: Timestamp,
    /// The first look of its present episode: later than `first_seen` if it came back.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
    /// The last look that shows it.
    #[schema(value_type = String, format = DateTime)]
    last_seen: Timestamp,
    /// The first look that shows the old state again; null while the new state stands.
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
    /// Alerts that tell of the same place.
    related: Vec<String>,
    /// Who sees to it; null if nobody does.
    #[schema(required)]
    assignee: Option<String>,
    /// How many comments there are.
    comments: i64,
    /// Whether a zone mutes it: webhooks are not sent it, and it does not count among the open alerts.
    muted: bool,
    /// When that ends by itself; null if it does not, or if it is not muted.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    muted_until: Option<Timestamp>,
    /// Every status that it had, the first one first.
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

/// The other side of one event: what left one place and stands at another.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertCounterpart)]
struct CounterpartBody {
    /// What the other side shows.
    kind: ChangeKind,
    /// A simple polygon round it, map frame, metres, counter-clockwise, not closed.
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

/// A closure's place in the residual series of its sub-graph.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertResidual)]
struct AlertResidualBody {
    /// The closure.
    edge_id: i64,
    /// What it added to the optimum F.
    delta_f: f64,
    /// The paper's threshold; null while the series warms up.
    #[schema(required)]
    threshold: Option<f64>,
    /// `delta_f` over the threshold; null while the series warms up.
    #[schema(required)]
    ratio: Option<f64>,
    /// Probability of a `delta_f` this large without a change.
    p_value: f64,
    /// Whether the paper's rule calls it a contradiction.
    seed_rule: bool,
}

/// A status that an alert took.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertHistoryEntry)]
struct HistoryBody {
    /// From then on.
    status: AlertStatus,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// Who: a name, or `system`.
    by: String,
    /// Why, for people.
    #[schema(required)]
    note: Option<String>,
    /// Why it was dismissed; null where nobody says, and of every other status.
    #[schema(required)]
    reason: Option<DismissReason>,
}

/// The ETag of an alert.
pub(super) fn etag(alert: &AlertRecord) -> String {
    format!("\"{}\"", alert.decision_revision)
}

/// What can be done with an alert now.
fn allowed_actions(alert: &AlertRecord) -> Vec<AlertAction> {
    let all = AlertAction::ALL.into_iter();
    all.filter(|action| is_allowed(alert, *action)).collect()
}

/// Corners as arrays.
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
