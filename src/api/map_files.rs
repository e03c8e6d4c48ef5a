//! The pictures of a route's map: of the draft, drawn once per revision and layer, or of a version that has
//! ended.

use std::sync::Arc;

use super::ApiState;
use super::map_cache::{MapFiles, MapKey, Shown};
use super::problem::Problem;
use crate::change::PendingChange;
use crate::model::MapLayer;
use crate::pipeline::DrawnScans;
use crate::render::{Decided, MapImageError, MapPicture, MapRaster};
use crate::scan::CodecError;
use crate::store::{AcceptedChange, NodeWithScan, RouteRecord};

/// The cells of a picture.
///
/// # Errors
/// An internal [`Problem`] if the picture does not read back.
pub(super) fn raster(files: &MapFiles) -> Result<MapRaster<'_>, Problem> {
    let yaml = std::str::from_utf8(&files.yaml).map_err(Problem::internal)?;
    MapRaster::read(&files.pgm, yaml).ok_or_else(|| {
        let error = std::io::Error::other("a map's picture does not read back");
        Problem::internal(error)
    })
}

/// The pictures of a map, from the cache or drawn again.
///
/// # Errors
/// The [`Problem`] that there is no map yet.
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
    let picture = state.maps.of((route.id.clone(), shown));
    let mut kept = picture.lock_owned().await;
    if let Some((_, files)) = kept.as_ref().filter(|(of, _)| *of == key) {
        return Ok(files.clone());
    }
    let (state, route) = (state.clone(), route.clone());
    // A task of its own: a picture is drawn to its end whoever goes away, and asked for again it would be
    // drawn twice at once.
    let drawing = tokio::spawn(async move {
        let files = Arc::new(match shown {
            Shown::Draft(layer) => drawn(&state, &route, layer).await?,
            Shown::Version(version) => {
                let picture = state.store.map_version_picture(&route.id, version).await?;
                let unknown = || Problem::not_found("version of the map");
                picture.ok_or_else(unknown)?.into()
            }
        });
        *kept = Some((key, files.clone()));
        Ok::<_, Problem>(files)
    });
    drawing.await.map_err(Problem::internal)?
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

#[derive(Debug, thiserror::Error)]
enum DrawError {
    #[error("a stored scan does not decode")]
    Scan(#[from] CodecError),
    #[error("the picture could not be written")]
    Image(#[from] MapImageError),
}

fn draw(
    nodes: &[NodeWithScan],
    accepted: &[AcceptedChange],
    pending: &[PendingChange],
) -> Result<MapPicture, DrawError> {
    let scans = DrawnScans::of(nodes)?;
    let decided = Decided { accepted, pending };
    Ok(MapPicture::draw(scans.posed(), decided)?)
}
