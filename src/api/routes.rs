//! Routes: one map, one pose graph each.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::ApiState;
use super::access::Identity;
use super::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use super::if_match::if_match;
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::parameters::RouteParam;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{
    AnyProblems, RouteDeletionProblems, RouteProblems, RoutePutProblems,
};
use super::upload::small_json;
use crate::ids::RouteId;
use crate::model::{Actor, Detector, Stage};
use crate::store::{
    Deleted, GeoAnchor, Put, RouteEdition, RouteRecord, RouteUpdate, SettingsUpdate,
};

const DISPLAY_NAME_CHARS_MAX: usize = 200;
const FALSE_ALARM_RATE_MAX: f64 = 1.0;
const HOLD_S_MAX: u32 = 7 * 24 * 3_600;
const MAX_SHIFT_MIN_M: f64 = 1e-3;
const MAX_SHIFT_MAX_M: f64 = 1.0;

/// A route.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Route)]
pub(super) struct RouteBody {
    /// Chosen by the client.
    #[schema(example = "line-4")]
    id: String,
    /// For people.
    #[schema(required)]
    display_name: Option<String>,
    /// Where the map lies on the Earth.
    #[schema(required)]
    geo_anchor: Option<GeoAnchorBody>,
    /// Whether the reference is still being built.
    stage: Stage,
    /// Raised by every accepted change.
    map_version: i64,
    /// Raised by every accepted change.
    epoch: i64,
    /// What the route holds.
    counts: RouteCountsBody,
    /// 0 when everything uploaded so far is processed.
    pending_batches: i64,
    /// What its keeper set.
    settings: RouteSettingsBody,
    /// When it was first put.
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
    /// The rule that decides that something changed.
    detector: Detector,
    /// False alerts per lap that are accepted. A lap is as much driven way as the route's reference
    /// is long.
    #[schema(exclusive_minimum = 0.0, maximum = 1.0)]
    false_alarm_rate: f64,
    /// How long a batch waits for its predecessor, seconds.
    hold_s: u32,
    /// How far a batch may move what others have mapped, metres; one that would move it farther, and
    /// farther than three standard deviations of its pose, is quarantined.
    max_shift_m: f64,
}

/// Where a route's map frame lies on the Earth (WGS 84).
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = GeoAnchor)]
struct GeoAnchorBody {
    /// Degrees.
    #[schema(minimum = -90, maximum = 90)]
    latitude: f64,
    /// Degrees.
    #[schema(minimum = -180, maximum = 180)]
    longitude: f64,
    /// Direction of the map's x axis, degrees clockwise from north.
    #[schema(minimum = 0, maximum = 360)]
    heading: f64,
}

/// What a PUT of a route sets; what is left out stays as it is.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct RoutePut {
    /// For people, up to 200 characters.
    #[schema(max_length = 200, pattern = r"^[^\x00-\x1f\x7f-\x9f]*$")]
    display_name: Option<String>,
    /// Where the map lies on the Earth.
    geo_anchor: Option<GeoAnchorBody>,
    /// How the route is watched.
    settings: Option<RouteSettingsPut>,
}

/// Settings to change; what is left out stays as it is.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct RouteSettingsPut {
    /// The rule that decides that something changed.
    detector: Option<Detector>,
    /// False alerts per lap that are accepted; 0.01 for a new route. A lap is as much driven way as
    /// the route's reference is long.
    #[schema(exclusive_minimum = 0.0, maximum = 1.0, example = 0.01)]
    false_alarm_rate: Option<f64>,
    /// How long a batch waits for its predecessor, seconds.
    #[schema(minimum = 0, maximum = 604800)]
    hold_s: Option<u32>,
    /// How far a batch may move what others have mapped, metres; 0.02 for a new route. One that would
    /// move it farther, and farther than three standard deviations of its pose, is quarantined.
    #[schema(minimum = 0.001, maximum = 1.0, example = 0.02)]
    max_shift_m: Option<f64>,
}

/// A part of the list of routes.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct RoutePage {
    /// By id.
    items: Vec<RouteBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for RoutePage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

impl From<RouteRecord> for RouteBody {
    fn from(route: RouteRecord) -> Self {
        let counts = route.counts;
        Self {
            id: route.id.to_string(),
            display_name: route.display_name,
            geo_anchor: route.geo_anchor.map(|anchor| GeoAnchorBody {
                latitude: anchor.latitude,
                longitude: anchor.longitude,
                heading: anchor.heading,
            }),
            stage: route.stage,
            map_version: route.map_version,
            epoch: route.epoch,
            counts: RouteCountsBody {
                batches: counts.batches,
                scans: counts.scans,
                nodes: counts.nodes,
                edges: counts.edges,
                loop_closures: counts.loop_closures,
                subgraphs: counts.subgraphs,
                vehicles: counts.vehicles,
                open_alerts: counts.open_alerts,
            },
            pending_batches: route.pending_batches,
            settings: RouteSettingsBody {
                detector: route.settings.detector,
                false_alarm_rate: route.settings.false_alarm_rate,
                hold_s: route.settings.hold_s,
                max_shift_m: route.settings.max_shift_m,
            },
            created_at: route.created_at,
            updated_at: route.updated_at,
        }
    }
}

impl RoutePut {
    fn check(self) -> Result<RouteUpdate, Problem> {
        let refuse = |pointer: &str, detail: &str| {
            Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer))
        };
        if let Some(name) = &self.display_name
            && (name.chars().count() > DISPLAY_NAME_CHARS_MAX || name.chars().any(char::is_control))
        {
            return refuse(
                "/display_name",
                "a name for people has at most 200 characters and no control characters",
            );
        }
        if let Some(anchor) = &self.geo_anchor {
            for (pointer, value, low, high) in [
                ("/geo_anchor/latitude", anchor.latitude, -90.0, 90.0),
                ("/geo_anchor/longitude", anchor.longitude, -180.0, 180.0),
                ("/geo_anchor/heading", anchor.heading, 0.0, 360.0),
            ] {
                if !(low..=high).contains(&value) {
                    return refuse(pointer, "not an angle of this kind, in degrees");
                }
            }
        }
        let settings = self.settings.unwrap_or_default();
        let is_rate = |rate: f64| rate > 0.0 && rate <= FALSE_ALARM_RATE_MAX;
        if settings.false_alarm_rate.is_some_and(|rate| !is_rate(rate)) {
            return refuse(
                "/settings/false_alarm_rate",
                "a number of false alerts per lap is in (0, 1]",
            );
        }
        if settings.hold_s.is_some_and(|hold_s| hold_s > HOLD_S_MAX) {
            return refuse("/settings/hold_s", "a batch is held for a week at most");
        }
        let is_shift = |shift_m: f64| (MAX_SHIFT_MIN_M..=MAX_SHIFT_MAX_M).contains(&shift_m);
        if settings
            .max_shift_m
            .is_some_and(|shift_m| !is_shift(shift_m))
        {
            return refuse(
                "/settings/max_shift_m",
                "a map may be moved by 0.001 m to 1 m",
            );
        }
        Ok(RouteUpdate {
            display_name: self.display_name,
            geo_anchor: self.geo_anchor.map(|anchor| GeoAnchor {
                latitude: anchor.latitude,
                longitude: anchor.longitude,
                heading: anchor.heading,
            }),
            settings: SettingsUpdate {
                detector: settings.detector,
                false_alarm_rate: settings.false_alarm_rate,
                hold_s: settings.hold_s,
                max_shift_m: settings.max_shift_m,
            },
            expected: None,
        })
    }
}

/// Changes with every result and with every edit.
fn etag(route: &RouteRecord) -> String {
    let edited = route.updated_at.as_microsecond();
    format!("\"{}-{edited:x}\"", route.revision)
}

fn with_etag(status: StatusCode, route: RouteRecord) -> Response {
    let tag = etag(&route);
    (status, [(header::ETAG, tag)], Json(RouteBody::from(route))).into_response()
}

/// The route that `If-Match` allows to be written; `None` without the header.
///
/// # Errors
/// [`ProblemKind::PreconditionFailed`] if the route is another, or not there.
async fn expected(
    state: &ApiState,
    headers: &HeaderMap,
    id: &RouteId,
) -> Result<Option<RouteEdition>, Problem> {
    if !headers.contains_key(header::IF_MATCH) {
        return Ok(None);
    }
    let current = state.store.route(id).await?;
    let is_meant = |route: &RouteRecord| if_match(headers, &etag(route)).unwrap_or(true);
    let route = current.filter(is_meant).ok_or_else(not_as_if_match_says)?;
    Ok(Some(route.edition()))
}

fn not_as_if_match_says() -> Problem {
    Problem::new(
        ProblemKind::PreconditionFailed,
        "the route is not as If-Match says: read it again",
    )
}

/// Create or change a route.
///
/// Makes the route if it is not there. Fields that are left out stay as they are.
#[utoipa::path(
    put, path = "/v1/routes/{route}", tag = "routes",
    params(
        RouteParam,
        ("If-Match" = Option<String>, Header, nullable = false, description = "Refuse the write unless the route has this ETag"),
    ),
    request_body(content = RoutePut, description = "What to set"),
    responses(
        (status = 200, description = "Changed", body = RouteBody, headers(("ETag" = String, description = "Changes with the route"))),
        (status = 201, description = "Created", body = RouteBody, headers(("ETag" = String, description = "Changes with the route"))),
        RoutePutProblems,
    )
)]
pub(super) async fn put_route(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<RouteId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let put: RoutePut = small_json(&state, &headers, body).await?;
    let update = RouteUpdate {
        expected: expected(&state, &headers, &id).await?,
        ..put.check()?
    };
    let put = state.store.put_route(&id, update, &by, Timestamp::now());
    let status = match put.await? {
        Put::Created => StatusCode::CREATED,
        Put::Updated => StatusCode::OK,
        Put::Stale => return Err(not_as_if_match_says()),
        // A map that is made by one detector's rule cannot go on by another's.
        Put::DetectorFixed => {
            let detail = "choose the detector before the first batch, or make another route";
            let problem = Problem::new(ProblemKind::DetectorFixed, detail);
            return Err(problem.at("/settings/detector"));
        }
    };
    let route = state.known_route(&id).await?;
    Ok(with_etag(status, route))
}

/// Read a route.
///
/// What the route holds, how it is watched, and whether anything still waits to be processed.
#[utoipa::path(
    get, path = "/v1/routes/{route}", tag = "routes",
    params(RouteParam),
    responses((status = 200, description = "The route", body = RouteBody, headers(("ETag" = String, description = "Changes with the route"))), RouteProblems)
)]
pub(super) async fn get_route(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<RouteId>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let route = state.known_route(&id).await?;
    Ok(with_etag(StatusCode::OK, route))
}

/// List routes.
///
/// All routes by id, in parts; of a key that is limited to some, those.
#[utoipa::path(
    get, path = "/v1/routes", tag = "routes", params(PageQuery),
    responses((status = 200, description = "A part of the list", body = RoutePage), AnyProblems)
)]
pub(super) async fn list_routes(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<RoutePage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<RouteId> = key_of_cursor(query.cursor.as_deref())?;
    let (store, after) = (&state.store, after.as_ref());
    let mut routes = match &identity.routes {
        None => store.routes(after, limit + 1).await?,
        Some(own) => store.routes_among(own, after, limit + 1).await?,
    };
    let next_cursor = cut_page(&mut routes, limit, |route| route.id.to_string());
    Ok(Listed(RoutePage {
        items: routes.into_iter().map(RouteBody::from).collect(),
        next_cursor,
    }))
}

/// Delete a route.
///
/// Deletes the route with its batches, its graph and its map, for good.
#[utoipa::path(
    delete, path = "/v1/routes/{route}", tag = "routes",
    params(
        RouteParam,
        ("If-Match" = Option<String>, Header, nullable = false, description = "Refuse the deletion unless the route has this ETag"),
    ),
    responses((status = 204, description = "Deleted"), RouteDeletionProblems)
)]
pub(super) async fn delete_route(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<RouteId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    if headers.contains_key(header::IF_MATCH) {
        state.known_route(&id).await?;
    }
    let expected = expected(&state, &headers, &id).await?;
    let deletion = state
        .store
        .delete_route(&id, expected, &by, Timestamp::now());
    match deletion.await? {
        Deleted::Done => Ok(StatusCode::NO_CONTENT),
        Deleted::NotThere => Err(Problem::unknown_route()),
        Deleted::Stale => Err(not_as_if_match_says()),
    }
}
