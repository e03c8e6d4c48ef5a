//! The pictures of a route's map: of the draft, drawn once per revision and layer, and of versions that
//! have ended.

use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;

use super::ApiState;
use super::if_match::is_known;
use super::problem::Problem;
use crate::change::PendingChange;
use crate::ids::RouteId;
use crate::model::MapLayer;
use crate::render::{Decided, MapImageError, MapPicture, PosedScan};
use crate::scan::CodecError;
use crate::store::{AcceptedChange, NodeWithScan, RouteRecord};

/// A picture has up to 24 MB, so only those that were asked for last are kept.
const PICTURES_KEPT: usize = 4;
/// A year, the longest time that caches keep anything. Not in caches that several people share.
const FOR_EVER: &str = "private, max-age=31536000, immutable";
const ASK_AGAIN: &str = "no-cache";

/// Which picture of a route's map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shown {
    /// As the map is now.
    Draft(MapLayer),
    /// As a version was when it ended.
    Version(i64),
}

/// The pictures in their formats.
pub(super) struct MapFiles {
    pub(super) png: Bytes,
    pub(super) pgm: Bytes,
    pub(super) yaml: Bytes,
}

impl From<MapPicture> for MapFiles {
    fn from(picture: MapPicture) -> Self {
        Self {
            png: picture.png.into(),
            pgm: picture.pgm.into(),
            yaml: picture.yaml.into(),
        }
    }
}

/// What pictures belong to: a deleted and newly made route starts at the same revision again.
#[derive(PartialEq)]
struct MapKey {
    created_at: Timestamp,
    /// Of the route; 0 for a version that has ended.
    revision: i64,
}

/// The newest pictures of one route. Whoever draws holds the lock, so that a picture that many ask for is
/// drawn once.
type RoutePictures = tokio::sync::Mutex<Option<(MapKey, Arc<MapFiles>)>>;

/// Pictures of a route, by what of it they show.
type CacheEntry = ((RouteId, Shown), Arc<RoutePictures>);

/// Pictures, the latest used last.
#[derive(Default)]
pub(super) struct MapCache {
    kept: Mutex<Vec<CacheEntry>>,
}

impl MapCache {
    /// The newest of the pictures that are shown; those that nobody has asked for longest make room.
    fn of(&self, shown: (RouteId, Shown)) -> Arc<RoutePictures> {
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

/// Which picture a request means: that of a version, else of what is observed, else of the newest released
/// version, and of the draft while none is released.
///
/// # Errors
/// The [`Problem`] that a version that has ended shows nothing but what was accepted.
pub(super) async fn meant(
    state: &ApiState,
    route: &RouteRecord,
    version: Option<i64>,
    layer: Option<MapLayer>,
) -> Result<Shown, Problem> {
    match (version, layer) {
        (Some(version), _) if version == route.map_version => {
            Ok(Shown::Draft(layer.unwrap_or_default()))
        }
        (Some(_), Some(MapLayer::Observed)) => {
            let detail = "a version that has ended shows what was accepted: leave the layer out";
            Err(Problem::parameter("layer", detail))
        }
        (Some(version), _) => Ok(Shown::Version(version)),
        (None, Some(MapLayer::Observed)) => Ok(Shown::Draft(MapLayer::Observed)),
        (None, _) => {
            let released = state.store.newest_release(&route.id).await?;
            Ok(released.map_or(Shown::Draft(MapLayer::Accepted), Shown::Version))
        }
    }
}

/// The ETag of what is made of a picture: the same as long as the picture is.
fn tag(route: &RouteRecord, shown: Shown) -> String {
    let created = route.created_at.as_millisecond();
    match shown {
        Shown::Draft(layer) => format!("\"{created:x}-{}-{}\"", route.revision, layer.name()),
        Shown::Version(version) => format!("\"{created:x}-v{version}\""),
    }
}

/// The pictures that are meant.
///
/// # Errors
/// The [`Problem`] that there is no map yet, or no such version.
pub(super) async fn map_files(
    state: &ApiState,
    route: &RouteRecord,
    shown: Shown,
) -> Result<Arc<MapFiles>, Problem> {
    let key = MapKey {
        created_at: route.created_at,
        revision: match shown {
            Shown::Draft(_) => route.revision,
            Shown::Version(_) => 0,
        },
    };
    let pictures = state.maps.of((route.id.clone(), shown));
    let mut kept = pictures.lock().await;
    if let Some((_, files)) = kept.as_ref().filter(|(of, _)| *of == key) {
        return Ok(files.clone());
    }
    let files = Arc::new(match shown {
        Shown::Draft(layer) => drawn(state, route, layer).await?,
        Shown::Version(version) => {
            let picture = state.store.map_version_picture(&route.id, version).await?;
            let unknown = || Problem::not_found("version of the map");
            picture.ok_or_else(unknown)?.into()
        }
    });
    *kept = Some((key, files.clone()));
    Ok(files)
}

async fn drawn(
    state: &ApiState,
    route: &RouteRecord,
    layer: MapLayer,
) -> Result<MapFiles, Problem> {
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
    let picture = state.rendering.run(work).await?;
    Ok(picture.map_err(Problem::internal)?.into())
}

fn draw(
    nodes: &[NodeWithScan],
    accepted: &[AcceptedChange],
    pending: &[PendingChange],
) -> Result<MapPicture, DrawError> {
    let mut scans = Vec::with_capacity(nodes.len());
    for node in nodes.iter().filter(|node| node.node.is_localised()) {
        scans.extend(node.decoded_scans()?);
    }
    let scans = scans.iter().map(|(stamp, map_from_base, scan)| PosedScan {
        stamp: *stamp,
        map_from_base: *map_from_base,
        scan,
    });
    Ok(MapPicture::draw(scans, Decided { accepted, pending })?)
}

/// An answer made of a picture, and how long it holds.
pub(super) struct Kept {
    tag: String,
    for_ever: bool,
}

impl Kept {
    /// Of what a request means that names this version, if any.
    pub(super) fn new(route: &RouteRecord, version: Option<i64>, shown: Shown) -> Self {
        Self {
            tag: tag(route, shown),
            for_ever: version.is_some() && matches!(shown, Shown::Version(_)),
        }
    }

    /// Of what is made of two pictures.
    pub(super) fn of_both(first: &Self, second: &Self) -> Self {
        let [a, b] = [&first.tag, &second.tag].map(|tag| tag.trim_matches('"'));
        Self {
            tag: format!("\"{a}-{b}\""),
            for_ever: first.for_ever && second.for_ever,
        }
    }

    /// The answer that the client's copy is still right, if it has one.
    pub(super) fn unchanged(&self, request: &HeaderMap) -> Option<Response> {
        let known = is_known(request, &self.tag);
        known.then(|| (StatusCode::NOT_MODIFIED, self.headers()).into_response())
    }

    /// The answer with a body.
    pub(super) fn answer(&self, media_type: &'static str, body: Bytes) -> Response {
        let media_type = HeaderValue::from_static(media_type);
        (self.headers(), [(header::CONTENT_TYPE, media_type)], body).into_response()
    }

    /// The ETag.
    pub(super) fn tag(&self) -> &str {
        &self.tag
    }

    /// The ETag, and how long the answer holds.
    pub(super) fn headers(&self) -> [(header::HeaderName, String); 2] {
        let caching = if self.for_ever { FOR_EVER } else { ASK_AGAIN };
        [
            (header::ETAG, self.tag.clone()),
            (header::CACHE_CONTROL, caching.to_owned()),
        ]
    }
}
