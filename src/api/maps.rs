//! Pictures of a route's map, drawn once per revision.

use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use utoipa::ToSchema;

use super::ApiState;
use super::extract::{ApiPath, NoQuery};
use super::parameters::{IfMapChanged, RouteParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use crate::ids::RouteId;
use crate::render::{Look, MapImageError, MapPicture};
use crate::scan::CodecError;
use crate::store::{AcceptedChange, NodeWithScan, RouteRecord};

/// A picture has up to 24 MB, so only the routes that are looked at are kept.
const ROUTES_KEPT: usize = 4;

/// Bytes of a picture.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code)]
pub(super) struct Binary(Vec<u8>);

/// The pictures of one route at one revision.
struct MapFiles {
    png: Bytes,
    pgm: Bytes,
    yaml: Bytes,
}

/// What a route's pictures belong to: a deleted and newly made route starts at the same revision again.
#[derive(PartialEq)]
struct MapKey {
    created_at: Timestamp,
    revision: i64,
}

/// The newest pictures of one route. Whoever draws holds the lock, so that a picture that many ask for is
/// drawn once.
type RoutePictures = tokio::sync::Mutex<Option<(MapKey, Arc<MapFiles>)>>;

/// Pictures by route, the latest used last.
#[derive(Default)]
pub(super) struct MapCache {
    kept: Mutex<Vec<(RouteId, Arc<RoutePictures>)>>,
}

impl MapCache {
    /// A route's pictures; those of the route that nobody has looked at for longest make room.
    fn of_route(&self, route: &RouteId) -> Arc<RoutePictures> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let place = kept.iter().position(|(other, _)| other == route);
        let found = match place {
            Some(place) => kept.remove(place),
            None => (route.clone(), Arc::default()),
        };
        let pictures = found.1.clone();
        kept.push(found);
        if kept.len() > ROUTES_KEPT {
            kept.remove(0);
        }
        pictures
    }
}

#[derive(Debug, thiserror::Error)]
enum DrawError {
    #[error("a stored scan does not decode")]
    Scan(#[from] CodecError),
    #[error("the picture could not be written")]
    Image(#[from] MapImageError),
}

async fn map_files(state: &ApiState, route: &RouteRecord) -> Result<Arc<MapFiles>, Problem> {
    let key = MapKey {
        created_at: route.created_at,
        revision: route.revision,
    };
    let pictures = state.maps.of_route(&route.id);
    let mut drawn = pictures.lock().await;
    if let Some((_, files)) = drawn.as_ref().filter(|(of, _)| *of == key) {
        return Ok(files.clone());
    }
    if route.counts.nodes == 0 {
        return Err(Problem::not_found("map yet: nothing has been merged"));
    }
    let nodes = state.store.nodes_with_scans(&route.id).await?;
    let accepted = state.store.accepted_changes(&route.id).await?;
    let files = state.rendering.run(move || draw(&nodes, &accepted)).await?;
    let files = Arc::new(files.map_err(Problem::internal)?);
    *drawn = Some((key, files.clone()));
    Ok(files)
}

fn draw(nodes: &[NodeWithScan], accepted: &[AcceptedChange]) -> Result<MapFiles, DrawError> {
    let mut scans = Vec::with_capacity(nodes.len());
    for node in nodes.iter().filter(|node| node.node.is_localised()) {
        scans.extend(node.decoded_scans()?);
    }
    let looks = scans.iter().map(|(stamp, map_from_base, scan)| Look {
        stamp: *stamp,
        map_from_base: *map_from_base,
        scan,
    });
    let picture = MapPicture::draw(looks, accepted)?;
    Ok(MapFiles {
        png: picture.png.into(),
        pgm: picture.pgm.into(),
        yaml: picture.yaml.into(),
    })
}

async fn answer(
    state: &ApiState,
    route_id: &RouteId,
    request: &HeaderMap,
    media_type: &'static str,
    choose: impl Fn(&MapFiles) -> &Bytes,
) -> Result<Response, Problem> {
    let route = state.known_route(route_id).await?;
    let created = route.created_at.as_millisecond();
    let tag = format!("\"{created:x}-{}\"", route.revision);
    let known = request.get(header::IF_NONE_MATCH);
    let known = known.and_then(|v| v.to_str().ok()).unwrap_or_default();
    let headers = [
        (header::ETAG, tag.clone()),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
    ];
    if known.split(',').any(|other| other.trim() == tag) {
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let files = map_files(state, &route).await?;
    let body = choose(&files).clone();
    Ok((headers, [(header::CONTENT_TYPE, media_type)], body).into_response())
}

/// Read the map as a PNG picture.
///
/// Free white, occupied black, unknown light grey, y upwards, 5 cm a pixel. The ETag changes
/// with the map.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.png", tag = "map",
    params(RouteParam, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_png(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    answer(&state, &route_id, &headers, "image/png", |files| &files.png).await
}

/// Read the map as a PGM picture for ROS's `map_server`.
///
/// Binary PGM: 0 occupied, 254 free, 205 unknown, row 0 on top. `map.yaml` goes with it.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.pgm", tag = "map",
    params(RouteParam, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/x-portable-graymap", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_pgm(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let media_type = "image/x-portable-graymap";
    answer(&state, &route_id, &headers, media_type, |files| &files.pgm).await
}

/// Read the map's description for ROS's `map_server`.
///
/// Resolution, origin and thresholds of `map.pgm`.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.yaml", tag = "map",
    params(RouteParam, IfMapChanged),
    responses(
        (status = 200, description = "The description", body = String, content_type = "application/yaml", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_yaml(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    _: NoQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    answer(&state, &route_id, &headers, "application/yaml", |files| {
        &files.yaml
    })
    .await
}
