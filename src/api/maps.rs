//! Pictures of a route's map, drawn once per revision and layer.

use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::{ApiPath, ApiQuery};
use super::parameters::{IfMapChanged, RouteParam};
use super::problem::Problem;
use super::problem_responses::RoutePartProblems;
use crate::change::PendingChange;
use crate::ids::RouteId;
use crate::model::MapLayer;
use crate::render::{Decided, Look, MapImageError, MapPicture};
use crate::scan::CodecError;
use crate::store::{AcceptedChange, NodeWithScan, RouteRecord};

/// A picture has up to 24 MB, so only those that are looked at are kept.
const PICTURES_KEPT: usize = 4;

/// What the picture is to show.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LayerQuery {
    /// What of the world the map shows; `accepted` if left out.
    #[param(nullable = false, inline)]
    layer: Option<MapLayer>,
}

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

/// Whose picture, and of what.
type Shown = (RouteId, MapLayer);

/// Pictures, the latest used last.
#[derive(Default)]
pub(super) struct MapCache {
    kept: Mutex<Vec<(Shown, Arc<RoutePictures>)>>,
}

impl MapCache {
    /// The newest pictures of a layer of a route; those that nobody has looked at for longest make room.
    fn of(&self, shown: Shown) -> Arc<RoutePictures> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let place = kept.iter().position(|(other, _)| *other == shown);
        let found = match place {
            Some(place) => kept.remove(place),
            None => (shown, Arc::default()),
        };
        let pictures = found.1.clone();
        kept.push(found);
        if kept.len() > PICTURES_KEPT {
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

async fn map_files(
    state: &ApiState,
    route: &RouteRecord,
    layer: MapLayer,
) -> Result<Arc<MapFiles>, Problem> {
    let key = MapKey {
        created_at: route.created_at,
        revision: route.revision,
    };
    let pictures = state.maps.of((route.id.clone(), layer));
    let mut drawn = pictures.lock().await;
    if let Some((_, files)) = drawn.as_ref().filter(|(of, _)| *of == key) {
        return Ok(files.clone());
    }
    if route.counts.nodes == 0 {
        return Err(Problem::not_found("map yet: nothing has been merged"));
    }
    let nodes = state.store.nodes_with_scans(&route.id).await?;
    let accepted = state.store.accepted_changes(&route.id).await?;
    let pending = match layer {
        MapLayer::Accepted => state.store.pending_changes(&route.id).await?,
        MapLayer::Observed => Vec::new(),
    };
    let work = move || draw(&nodes, &accepted, &pending);
    let files = state.rendering.run(work).await?;
    let files = Arc::new(files.map_err(Problem::internal)?);
    *drawn = Some((key, files.clone()));
    Ok(files)
}

fn draw(
    nodes: &[NodeWithScan],
    accepted: &[AcceptedChange],
    pending: &[PendingChange],
) -> Result<MapFiles, DrawError> {
    let mut scans = Vec::with_capacity(nodes.len());
    for node in nodes.iter().filter(|node| node.node.is_localised()) {
        scans.extend(node.decoded_scans()?);
    }
    let looks = scans.iter().map(|(stamp, map_from_base, scan)| Look {
        stamp: *stamp,
        map_from_base: *map_from_base,
        scan,
    });
    let picture = MapPicture::draw(looks, Decided { accepted, pending })?;
    Ok(MapFiles {
        png: picture.png.into(),
        pgm: picture.pgm.into(),
        yaml: picture.yaml.into(),
    })
}

async fn answer(
    state: &ApiState,
    route_id: &RouteId,
    query: &LayerQuery,
    request: &HeaderMap,
    media_type: &'static str,
    choose: impl Fn(&MapFiles) -> &Bytes,
) -> Result<Response, Problem> {
    let route = state.known_route(route_id).await?;
    let created = route.created_at.as_millisecond();
    let layer = query.layer.unwrap_or_default();
    let tag = format!("\"{created:x}-{}-{}\"", route.revision, layer.name());
    let known = request.get(header::IF_NONE_MATCH);
    let known = known.and_then(|v| v.to_str().ok()).unwrap_or_default();
    let headers = [
        (header::ETAG, tag.clone()),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
    ];
    if known.split(',').any(|other| other.trim() == tag) {
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let files = map_files(state, &route, layer).await?;
    let body = choose(&files).clone();
    Ok((headers, [(header::CONTENT_TYPE, media_type)], body).into_response())
}

/// Read the map as a PNG picture.
///
/// Free white, occupied black, unknown light grey, y upwards, 5 cm a pixel. Changes that nobody has
/// accepted are left out. The ETag changes with the map.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.png", tag = "map",
    params(RouteParam, LayerQuery, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_png(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    answer(&state, &route_id, &query, &headers, "image/png", |files| {
        &files.png
    })
    .await
}

/// Read the map as a PGM picture for ROS's `map_server`.
///
/// Binary PGM: 0 occupied, 254 free, 205 unknown, row 0 on top. `map.yaml` goes with it.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.pgm", tag = "map",
    params(RouteParam, LayerQuery, IfMapChanged),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/x-portable-graymap", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_pgm(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let media_type = "image/x-portable-graymap";
    answer(&state, &route_id, &query, &headers, media_type, |files| {
        &files.pgm
    })
    .await
}

/// Read the map's description for ROS's `map_server`.
///
/// Resolution, origin and thresholds of `map.pgm`.
#[utoipa::path(
    get, path = "/v1/routes/{route}/map.yaml", tag = "map",
    params(RouteParam, LayerQuery, IfMapChanged),
    responses(
        (status = 200, description = "The description", body = String, content_type = "application/yaml", headers(("ETag" = String, description = "Changes with the map"))),
        (status = 304, description = "The map is as it was"),
        RoutePartProblems,
    )
)]
pub(super) async fn get_map_yaml(
    State(state): State<ApiState>,
    ApiPath(route_id): ApiPath<RouteId>,
    ApiQuery(query): ApiQuery<LayerQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    answer(
        &state,
        &route_id,
        &query,
        &headers,
        "application/yaml",
        |files| &files.yaml,
    )
    .await
}
