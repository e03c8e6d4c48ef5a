//! An alert's evidence as JSON.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::body::{LocationBody, corners};
use super::evidence::{Evidence, JudgedScan, gather};
use super::known::known_alert;
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::parameters::AlertParam;
use crate::api::problem::Problem;
use crate::api::problem_responses::AlertProblems;
use crate::api::residuals::ResidualSeriesBody;
use crate::api::types::{PoseBody, timestamp};
use crate::ids::AlertId;
use crate::model::{BeamVerdict, ChangeKind};
use crate::observation::miss_tolerance;

/// The evidence behind an alert, in the map as it is now.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertEvidence)]
pub(in crate::api) struct EvidenceBody {
    /// The alert.
    #[schema(format = "uuid")]
    alert_id: String,
    /// The route.
    route_id: String,
    /// What changed.
    kind: ChangeKind,
    /// Where it is.
    location: LocationBody,
    /// The region, map frame, metres, counter-clockwise, not closed.
    #[schema(value_type = Vec<Vec<f64>>)]
    region: Vec<[f64; 2]>,
    /// The loop closure between the two scans; null if they are not matched with each other. If the uploads
    /// had no scans, the closure whose residual shows the change.
    #[schema(required)]
    edge_id: Option<i64>,
    /// By how much two measured depths of the same surface may differ.
    tolerance: ToleranceBody,
    /// The two scans that contradict each other most within the region, the old one first; empty if the
    /// uploads had no scans.
    #[schema(max_items = 2)]
    scans: Vec<EvidenceScanBody>,
    /// The residual series, 40 closures on each side of the alert's; null without a closure.
    #[schema(required)]
    residuals: Option<ResidualSeriesBody>,
}

/// Two depths contradict each other if they differ by more than `depth` + 3 · `sigma_theta` · distance.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DepthTolerance)]
struct ToleranceBody {
    /// Metres.
    depth: f64,
    /// Radians.
    sigma_theta: f64,
}

/// A scan in the map frame, each beam judged by the other scan.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = EvidenceScan)]
struct EvidenceScanBody {
    /// Which state it shows.
    role: ScanRole,
    /// The node that it belongs to.
    node_id: i64,
    /// The vehicle that took it.
    vehicle_id: String,
    /// The trip on which it was taken.
    trip_id: String,
    /// When it was taken.
    #[schema(value_type = String, format = DateTime)]
    stamp: Timestamp,
    /// `map_from_base`.
    pose: PoseBody,
    /// `map_from_lidar`: where the beams begin.
    lidar_pose: PoseBody,
    /// In beam order.
    beams: Vec<BeamBody>,
}

/// Which state a scan shows.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum ScanRole {
    /// The earlier one.
    Old,
    /// The later one.
    New,
}

/// A beam.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = EvidenceBeam)]
struct BeamBody {
    /// The x of its end, map frame, metres; null without a return.
    #[schema(required)]
    x: Option<f64>,
    /// The y of its end; null without a return.
    #[schema(required)]
    y: Option<f64>,
    /// The other scan's verdict.
    verdict: BeamVerdict,
}

impl EvidenceScanBody {
    fn new(role: ScanRole, scan: &JudgedScan) -> Self {
        let beams = scan.beams.iter().map(|beam| BeamBody {
            x: beam.end.map(|end| end.x),
            y: beam.end.map(|end| end.y),
            verdict: beam.verdict,
        });
        Self {
            role,
            node_id: scan.node.id.0,
            vehicle_id: scan.node.vehicle_id.to_string(),
            trip_id: scan.node.trip_id.to_string(),
            stamp: timestamp(scan.node.stamp),
            pose: scan.node.pose.into(),
            lidar_pose: scan.map_from_lidar.into(),
            beams: beams.collect(),
        }
    }
}

impl From<&Evidence> for EvidenceBody {
    fn from(evidence: &Evidence) -> Self {
        let alert = &evidence.alert;
        let roles = [ScanRole::Old, ScanRole::New];
        let scans = || evidence.scans.iter().flatten();
        let sigmas_m = scans().map(|scan| scan.range_sigma_m);
        let (depth, depth_per_range) = miss_tolerance(sigmas_m.fold(0.0, f64::max));
        Self {
            alert_id: alert.id.to_string(),
            route_id: alert.route_id.to_string(),
            kind: alert.evidence.kind,
            location: LocationBody::of(alert),
            region: corners(&alert.evidence.region),
            edge_id: evidence.edge_id.map(|id| id.0),
            tolerance: ToleranceBody {
                depth,
                sigma_theta: depth_per_range / 3.0,
            },
            scans: (roles.into_iter().zip(scans()))
                .map(|(role, scan)| EvidenceScanBody::new(role, scan))
                .collect(),
            residuals: evidence.series.as_ref().map(ResidualSeriesBody::from),
        }
    }
}

/// Read the evidence behind an alert.
///
/// The two scans that contradict each other most at the place, beam by beam in the map frame, and the residual
/// series around the loop closure that shows the change best. For an alert about uploaded edges `scans` is
/// empty, and the series is the only evidence.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}/evidence", tag = "alerts",
    params(AlertParam),
    responses((status = 200, description = "The evidence", body = EvidenceBody), AlertProblems)
)]
pub(in crate::api) async fn get_evidence(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let alert = known_alert(&state, id).await?;
    let route = state.known_route(&alert.route_id).await?;
    let evidence = gather(&state, alert, &route).await?;
    let work = move || serde_json::to_vec(&EvidenceBody::from(&evidence));
    let document = state
        .rendering
        .run(work)
        .await?
        .map_err(Problem::internal)?;
    let media_type = [(header::CONTENT_TYPE, "application/json")];
    Ok((media_type, document).into_response())
}
