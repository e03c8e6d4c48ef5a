//! The picture of a route's map that a request asks for.

use std::sync::Arc;

use axum::body::Bytes;
use axum::http::HeaderMap;
use axum::response::Response;

use super::ApiState;
use super::map_cache::{MapFiles, Shown};
use super::map_files::map_files;
use super::map_validity::Validity;
use super::problem::Problem;
use super::versions::known_version;
use crate::ids::RouteId;
use crate::model::MapLayer;
use crate::store::RouteRecord;

/// A format of a map's picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MapFormat {
    Png,
    Pgm,
    Yaml,
}

impl MapFormat {
    fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Pgm => "image/x-portable-graymap",
            Self::Yaml => "application/yaml",
        }
    }

    fn of(self, files: &MapFiles) -> &Bytes {
        match self {
            Self::Png => &files.png,
            Self::Pgm => &files.pgm,
            Self::Yaml => &files.yaml,
        }
    }
}

/// A picture of a route's map that a request asks for.
pub(super) struct ShownMap {
    pub(super) route: RouteRecord,
    pub(super) shown: Shown,
    pub(super) validity: Validity,
}

impl ShownMap {
    /// The picture of the named version; else of what was observed, if that layer is asked for; else of
    /// the newest released version, or of the draft while none is released.
    ///
    /// # Errors
    /// The [`Problem`] that there is no such route or version, or that a version that has ended shows
    /// only what was accepted.
    pub(super) async fn of(
        state: &ApiState,
        route_id: &RouteId,
        version: Option<i64>,
        layer: Option<MapLayer>,
    ) -> Result<Self, Problem> {
        let route = state.known_route(route_id).await?;
        let shown = shown(state, &route, version, layer).await?;
        Ok(Self {
            validity: Validity::of(&route, version, shown),
            route,
            shown,
        })
    }

    /// The picture in all formats.
    ///
    /// # Errors
    /// The [`Problem`] that there is no map yet.
    pub(super) async fn files(&self, state: &ApiState) -> Result<Arc<MapFiles>, Problem> {
        map_files(state, &self.route, self.shown).await
    }

    /// The answer with the picture in one format, or that the client's copy is still valid.
    ///
    /// # Errors
    /// As [`Self::files`].
    pub(super) async fn answer(
        &self,
        state: &ApiState,
        request: &HeaderMap,
        format: MapFormat,
    ) -> Result<Response, Problem> {
        if let Some(unchanged) = self.validity.unchanged(request) {
            return Ok(unchanged);
        }
        let files = self.files(state).await?;
        let body = format.of(&files).clone();
        Ok(self.validity.answer(format.media_type(), body))
    }
}

async fn shown(
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
        (Some(version), _) => {
            known_version(state, &route.id, version).await?;
            Ok(Shown::Version(version))
        }
        (None, Some(MapLayer::Observed)) => Ok(Shown::Draft(MapLayer::Observed)),
        (None, _) => {
            let released = state.store.newest_release(&route.id).await?;
            Ok(released.map_or(Shown::Draft(MapLayer::Accepted), Shown::Version))
        }
    }
}
