//! Pictures of maps that were requested last, kept in memory.

use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use jiff::Timestamp;

use crate::ids::RouteId;
use crate::model::MapLayer;
use crate::render::MapPicture;

/// A picture has up to 24 MB, so only the few that were requested last are kept.
const PICTURES_KEPT: usize = 4;

/// Which picture of a route's map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shown {
    /// The draft as it is now.
    Draft(MapLayer),
    /// A version as it was when it ended.
    Version(i64),
}

/// A picture in each of its formats.
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

/// What a picture was made of. A route that was deleted and created again starts at the same revision, so
/// its creation is part of the key.
#[derive(PartialEq)]
pub(super) struct MapKey {
    pub(super) created_at: Timestamp,
    /// Of the route; 0 for a version that has ended.
    pub(super) revision: i64,
}

/// The newest picture of one route and layer or version. Whoever draws it holds the lock, so that a
/// picture that many clients request is drawn once.
pub(super) type CachedPicture = tokio::sync::Mutex<Option<(MapKey, Arc<MapFiles>)>>;

type CacheEntry = ((RouteId, Shown), Arc<CachedPicture>);

/// Pictures by route and what they show, the last used at the end.
#[derive(Default)]
pub(super) struct MapCache {
    kept: Mutex<Vec<CacheEntry>>,
}

impl MapCache {
    /// The place of a picture, which may still be empty; the least recently used ones are dropped.
    pub(super) fn of(&self, shown: (RouteId, Shown)) -> Arc<CachedPicture> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let place = kept.iter().position(|(other, _)| *other == shown);
        let found = match place {
            Some(place) => kept.remove(place),
            None => (shown, Arc::default()),
        };
        let picture = found.1.clone();
        kept.push(found);
        if kept.len() > PICTURES_KEPT {
            kept.remove(0);
        }
        picture
    }
}
