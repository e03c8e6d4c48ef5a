//! Alerts in geographic coordinates.

use std::collections::BTreeMap;

use axum::Extension;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::body::{AlertBandBody, ShiftBody};
use super::list::listed;
use super::query::AlertQuery;
use super::sentence::{summary, title};
use super::size::Size;
use super::tangent_plane::TangentPlane;
use crate::api::ApiState;
use crate::api::access::Identity;
use crate::api::extract::ApiQuery;
use crate::api::paging::{NextCursor, PageQuery};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::AlertMapProblems;
use crate::api::types::timestamp;
use crate::geometry::Vector2;
use crate::ids::RouteId;
use crate::model::{AlertStatus, ChangeKind, Clearance, Tier};
use crate::store::{AlertRecord, RouteRecord};

/// Alerts as GeoJSON (RFC 7946).
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertFeatureCollection)]
struct FeatureCollection {
    /// `FeatureCollection`.
    #[serde(rename = "type")]
    kind: &'static str,
    /// The newest first.
    features: Vec<Feature>,
    /// The cursor of the next page; null at the end of the list.
    #[schema(required)]
    next_cursor: Option<String>,
}

/// An alert in geographic coordinates.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertFeature)]
struct Feature {
    /// `Feature`.
    #[serde(rename = "type")]
    kind: &'static str,
    /// Id of the alert.
    #[schema(format = "uuid")]
    id: String,
    /// Its region.
    geometry: Polygon,
    /// The main fields of the alert.
    properties: Properties,
}

/// A polygon in WGS 84.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertPolygon)]
struct Polygon {
    /// `Polygon`.
    #[serde(rename = "type")]
    kind: &'static str,
    /// One ring, counter-clockwise and closed, of longitude and latitude, degrees.
    #[schema(value_type = Vec<Vec<Vec<f64>>>)]
    coordinates: [Vec<[f64; 2]>; 1],
}

/// The main fields of an alert; `GET /v1/alerts/{alert}` has all.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertProperties)]
struct Properties {
    /// The route.
    route_id: String,
    /// What changed.
    kind: ChangeKind,
    /// Whether it awaits a decision, and what was decided.
    status: AlertStatus,
    /// How well it is supported.
    tier: Tier,
    /// What happened, in a few words for people.
    title: String,
    /// The same in one sentence. Times are UTC.
    summary: String,
    /// The size of its region; null without a region.
    #[schema(required)]
    size: Option<Size>,
    /// How near the change is to the path that vehicles took before it; null if that is not known.
    #[schema(required)]
    blocking: Option<Clearance>,
    /// The other side of the same event; null if none is known.
    #[schema(required)]
    counterpart: Option<CounterpartProperty>,
    /// For a `map_mismatch` that a single shift explains: the vector that would move what the pass observed
    /// onto the map; metres, in the map frame. Null for all other alerts.
    #[schema(required)]
    shift: Option<ShiftBody>,
    /// The height bands that show it; empty if it was observed by lidars that scan a single plane.
    bands: Vec<AlertBandBody>,
    /// The probability that the alert is true.
    confidence: f64,
    /// Standard deviation of its location, metres.
    sigma: f64,
    /// The first observation that ever showed it.
    #[schema(value_type = String, format = DateTime)]
    first_seen: Timestamp,
    /// The last observation that shows it.
    #[schema(value_type = String, format = DateTime)]
    last_seen: Timestamp,
}

/// The other side of one event: an object that left one place and appeared at another.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertPropertiesCounterpart)]
struct CounterpartProperty {
    /// The change on the other side.
    kind: ChangeKind,
    /// Its region.
    region: Polygon,
}

/// List alerts as GeoJSON.
///
/// The regions in WGS 84, projected by the plane that touches the Earth at the route's `geo_anchor`. Routes
/// without a usable anchor are left out, and refused if `route_id` names one. `bbox` is in the map frame,
/// metres.
#[utoipa::path(
    get, path = "/v1/alerts.geojson", tag = "alerts", params(AlertQuery, PageQuery),
    responses((status = 200, description = "A page of the list", body = inline(FeatureCollection), content_type = "application/geo+json"), AlertMapProblems)
)]
pub(in crate::api) async fn list_alerts_geojson(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<AlertQuery>,
) -> Result<Response, Problem> {
    if let Some(route) = query.filter()?.route_id {
        identity.check_route(&route)?;
        required_plane(&state.known_route(&route).await?)?;
    }
    let (alerts, next_cursor) = listed(&state, &identity, &query).await?;
    let mut planes: BTreeMap<RouteId, Option<TangentPlane>> = BTreeMap::new();
    let mut features = Vec::with_capacity(alerts.len());
    for alert in &alerts {
        let plane = match planes.get(&alert.route_id) {
            Some(plane) => *plane,
            None => {
                let route = state.store.route(&alert.route_id).await?;
                let plane = route.and_then(|route| plane_of(&route));
                planes.insert(alert.route_id.clone(), plane);
                plane
            }
        };
        features.extend(plane.map(|plane| Feature::new(alert, &plane)));
    }
    let collection = FeatureCollection {
        kind: "FeatureCollection",
        features,
        next_cursor: next_cursor.clone(),
    };
    let document = serde_json::to_vec(&collection).map_err(Problem::internal)?;
    let media_type = [(header::CONTENT_TYPE, "application/geo+json")];
    let next = Extension(NextCursor(next_cursor));
    Ok((media_type, next, document).into_response())
}

fn plane_of(route: &RouteRecord) -> Option<TangentPlane> {
    route.geo_anchor.as_ref().and_then(TangentPlane::at)
}

fn required_plane(route: &RouteRecord) -> Result<TangentPlane, Problem> {
    let detail = if route.geo_anchor.is_none() {
        "the map's place on the Earth is not known: PUT the route with \
         {\"geo_anchor\": {\"latitude\", \"longitude\", \"heading\"}} in degrees; heading is that of \
         the map's x axis, clockwise from north"
    } else {
        "the route's geo_anchor lies within one degree of a pole, where no plane fits the Earth: \
         PUT the route with another one"
    };
    let refuse = || Problem::new(ProblemKind::NoGeoAnchor, detail).at("route_id");
    plane_of(route).ok_or_else(refuse)
}

impl Polygon {
    /// A region of the map frame in geographic coordinates.
    fn of(region: &[Vector2<f64>], plane: &TangentPlane) -> Self {
        let corners = region.iter().chain(region.first());
        let ring = corners.map(|corner| plane.longitude_latitude(corner).map(rounded));
        Self {
            kind: "Polygon",
            coordinates: [ring.collect()],
        }
    }
}

impl Feature {
    fn new(alert: &AlertRecord, plane: &TangentPlane) -> Self {
        let evidence = &alert.evidence;
        let counterpart = evidence.counterpart.as_ref();
        let size = Size::of(&evidence.region);
        Self {
            kind: "Feature",
            id: alert.id.to_string(),
            geometry: Polygon::of(&evidence.region, plane),
            properties: Properties {
                route_id: alert.route_id.to_string(),
                kind: evidence.kind,
                status: alert.status,
                tier: evidence.tier,
                title: title(alert, size),
                summary: summary(alert, size),
                size,
                blocking: alert.clearance,
                counterpart: counterpart.map(|counterpart| CounterpartProperty {
                    kind: counterpart.kind,
                    region: Polygon::of(&counterpart.region, plane),
                }),
                shift: evidence.shift.map(ShiftBody::from),
                bands: evidence.bands.iter().map(AlertBandBody::from).collect(),
                confidence: evidence.confidence,
                sigma: evidence.sigma_m,
                first_seen: timestamp(alert.first_seen),
                last_seen: timestamp(evidence.last_seen),
            },
        }
    }
}

/// Nine decimals of a degree are a tenth of a millimetre.
fn rounded(degrees: f64) -> f64 {
    (degrees * 1e9).round() / 1e9
}
