//! An alert's evidence as a picture.

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::evidence::{Evidence, JudgedScan, gather};
use super::known::known_alert;
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::if_match::is_known;
use crate::api::parameters::{AlertParam, IfNoneMatch};
use crate::api::problem::Problem;
use crate::api::problem_responses::AlertProblems;
use crate::api::types::timestamp;
use crate::ids::AlertId;
use crate::render::evidence_svg::{Curve, EvidencePicture, EvidenceScan, to_svg};

/// A picture may also be opened by itself: nothing in it may run or load.
pub(super) const PICTURE_POLICY: &str = "default-src 'none'; frame-ancestors 'none'; sandbox";

/// Read the evidence behind an alert as an SVG picture.
///
/// Both scans in the map frame, where they contradict each other, the region, and the residuals around the
/// loop closure against the paper's threshold. The ETag changes with the alert and with the map.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}/evidence.svg", tag = "alerts",
    params(AlertParam, IfNoneMatch),
    responses(
        (status = 200, description = "The picture", body = String, content_type = "image/svg+xml", headers(("ETag" = String, description = "Changes with the evidence"))),
        (status = 304, description = "The evidence has not changed"),
        AlertProblems,
    )
)]
pub(in crate::api) async fn get_evidence_svg(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    request: HeaderMap,
) -> Result<Response, Problem> {
    let alert = known_alert(&state, id).await?;
    let route = state.known_route(&alert.route_id).await?;
    let tag = format!("\"{}-{}\"", alert.revision, route.revision);
    let headers = [
        (header::ETAG, tag.clone()),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
        (header::CONTENT_SECURITY_POLICY, PICTURE_POLICY.to_owned()),
    ];
    if is_known(&request, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let evidence = gather(&state, alert, &route).await?;
    let picture = state.rendering.run(move || draw(&evidence)).await?;
    let media_type = [(header::CONTENT_TYPE, "image/svg+xml")];
    Ok((headers, media_type, picture).into_response())
}

fn draw(evidence: &Evidence) -> String {
    let alert = &evidence.alert;
    let finding = &alert.evidence;
    let scans = evidence.scans.as_ref();
    let captions = scans.map(|scans| scans.each_ref().map(caption));
    let posed = scans.zip(captions.as_ref());
    let posed = posed.map(|([old, new], [of_old, of_new])| {
        [(old, of_old), (new, of_new)].map(|(scan, caption)| EvidenceScan {
            caption,
            map_from_base: scan.node.pose,
            beams: &scan.beams,
        })
    });
    let curve = evidence.series.as_ref().zip(evidence.shown_by);
    to_svg(&EvidencePicture {
        kind: finding.kind,
        route: alert.route_id.as_str(),
        status: alert.status.name(),
        location: finding.location,
        sigma_m: finding.sigma_m,
        region: &finding.region,
        laps: finding.laps,
        views: finding.views,
        confidence: finding.confidence,
        scans: posed,
        tied: evidence.ends,
        curve: curve.map(|(around, edge)| Curve {
            entries: &around.series.entries,
            threshold: around.series.threshold,
            edge,
        }),
    })
}

/// The vehicle and the trip of a scan, and when it was taken, to the second.
fn caption(scan: &JudgedScan) -> String {
    let node = &scan.node;
    let time = timestamp(node.stamp).strftime("%F %T UTC");
    format!("{}, {}, {time}", node.vehicle_id, node.trip_id)
}
