//! An alert's evidence as JSON.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::body::{LocationBody, corners};
use super::evidence::{Evidence, LookBack, gather};
use super::known_alert;
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

/// What an alert rests on, in the map as it stands now.
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
    /// The loop closure between the two scans; null if they are not matched with each other.
    /// Where the uploads had no scans, the closure whose residual tells the alert.
    #[schema(required)]
    edge_id: Option<i64>,
    /// How far the depths of one surface may differ.
    tolerance: ToleranceBody,
    /// The two scans that contradict each other most within the region, the old one first; none
    /// where the uploads had no scans.
    #[schema(max_items = 2)]
    scans: Vec<EvidenceScanBody>,
    /// The residual series, 40 closures to each side of the alert's; null without a closure.
    #[schema(required)]
    residuals: Option<ResidualSeriesBody>,
}

/// A depth contradicts beyond `depth` + 3 · `sigma_theta` · distance.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DepthTolerance)]
struct ToleranceBody {
    /// Metres.
    depth: f64,
    /// Radians.
    sigma_theta: f64,
}

/// A scan in the map frame, each beam with what the other scan says of it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = EvidenceScan)]
struct EvidenceScanBody {
    /// Which state it shows.
    role: ScanRole,
    /// The node it belongs to.
    node_id: i64,
    /// Who took it.
    vehicle_id: String,
    /// On which drive.
    trip_id: String,
    /// When.
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
    /// Where it ended, map frame, metres; null without a return.
    #[schema(required)]
    x: Option<f64>,
    /// As `x`.
    #[schema(required)]
    y: Option<f64>,
    /// What the other scan says.
    verdict: BeamVerdict,
}

impl EvidenceScanBody {
    fn new(role: ScanRole, look: &LookBack) -> Self {
        let beams = look.beams.iter().map(|beam| BeamBody {
            x: beam.end.map(|end| end.x),
            y: beam.end.map(|end| end.y),
            verdict: beam.verdict,
        });
        Self {
            role,
            node_id: look.node.id.0,
            vehicle_id: look.node.vehicle_id.to_string(),
            trip_id: look.node.trip_id.to_string(),
            stamp: timestamp(look.node.stamp),
            pose: look.node.pose.into(),
            lidar_pose: look.map_from_lidar.into(),
            beams: beams.collect(),
        }
    }
}

impl From<&Evidence> for EvidenceBody {
    fn from(evidence: &Evidence) -> Self {
        let alert = &evidence.alert;
        let roles = [ScanRole::Old, ScanRole::New];
        let sigmas_m = evidence
            .looks
            .iter()
            .flatten()
            .map(|look| look.range_sigma_m);
        let (depth, depth_per_range) = miss_tolerance(sigmas_m.fold(0.0, f64::max));
        let looks = roles.into_iter().zip(evidence.looks.iter().flatten());
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
            scans: looks
                .map(|(role, look)| EvidenceScanBody::new(role, look))
                .collect(),
            residuals: evidence.series.as_ref().map(ResidualSeriesBody::from),
        }
    }
}

/// Read the evidence behind an alert.
///
/// The two scans that contradict each other most at the place, in the map frame and beam by beam,
/// and the residual series around the closure that tells it. An alert by closures that came as
/// edges has no scans: `scans` is empty, and the series is all there is.
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
