//! Releases the present version of a map to vehicles: its picture is kept, and the next version begins.

use super::accept::picture_of;
use super::decide::{Decisions, TRIES_MAX};
use super::engine::{Engine, as_kept};
use crate::ids::RouteId;
use crate::model::{Actor, VersionState};
use crate::store::{Decided, MapVersionRecord, Release, StoreError, VersionRelease};

/// A requested release.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReleaseOrder {
    /// The route.
    pub route_id: RouteId,
    /// Its present version.
    pub version: i64,
    /// Who sent the request, for the audit.
    pub actor: Actor,
    /// When, by whom and why.
    pub release: VersionRelease,
}

/// Why a version was not released; nothing has changed then.
#[derive(Debug, thiserror::Error)]
pub enum ReleaseError {
    /// There is no such version.
    #[error("there is no such version")]
    UnknownVersion,
    /// It has ended without a release, or was withdrawn.
    #[error("a version that has ended cannot be released")]
    NotAllowed(Box<MapVersionRecord>),
    /// There is no map yet.
    #[error("nothing has been merged yet")]
    Empty,
    /// Batches and decisions kept changing the route.
    #[error("the route changes too quickly")]
    Busy,
    /// The store failed or refused the release.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The picture could not be made.
    #[error("the map's picture could not be made")]
    Failed(#[source] anyhow::Error),
}

impl Decisions {
    /// Releases a route's present version and returns it; one that is already released stays as it is. Waits
    /// for the batch that the route is processing, and is finished even if the caller goes away.
    ///
    /// # Errors
    /// [`ReleaseError`]; nothing has changed then.
    pub async fn release(&self, order: ReleaseOrder) -> Result<MapVersionRecord, ReleaseError> {
        let engine = self.engine.clone();
        let task = tokio::spawn(async move { release(&engine, &order).await });
        task.await
            .map_err(|error| ReleaseError::Failed(error.into()))?
    }
}

async fn release(engine: &Engine, order: &ReleaseOrder) -> Result<MapVersionRecord, ReleaseError> {
    for _ in 0..TRIES_MAX {
        let _turn = engine.turn(&order.route_id).await;
        let found = engine.store.map_version(&order.route_id, order.version);
        let version = found.await?.ok_or(ReleaseError::UnknownVersion)?;
        match version.state() {
            VersionState::Draft => {}
            VersionState::Released => return Ok(version),
            VersionState::Retired => return Err(ReleaseError::NotAllowed(Box::new(version))),
        }
        if try_once(engine, order).await? == Decided::Committed {
            let found = engine.store.map_version(&order.route_id, order.version);
            return found.await?.ok_or(ReleaseError::UnknownVersion);
        }
    }
    Err(ReleaseError::Busy)
}

/// Draws the map and writes the release, unless the route changed meanwhile.
async fn try_once(engine: &Engine, order: &ReleaseOrder) -> Result<Decided, ReleaseError> {
    let taken = engine.workspaces.take(&engine.store, &order.route_id).await;
    let workspace = taken.map_err(of_computation)?;
    if workspace.map.keyframes().is_empty() {
        return Err(ReleaseError::Empty);
    }
    let drawn = engine.compute(move || picture_of(&workspace).map(|picture| (workspace, picture)));
    let drawn = drawn.await.and_then(|drawn| drawn);
    let (mut workspace, picture) = drawn.map_err(of_computation)?;
    let release = Release {
        route_id: order.route_id.clone(),
        version: order.version,
        base_revision: workspace.revision,
        actor: order.actor.clone(),
        release: VersionRelease {
            at: as_kept(order.release.at),
            ..order.release.clone()
        },
        picture,
    };
    let outcome = engine.store.apply_release(release).await?;
    if outcome == Decided::Committed {
        workspace.map_version += 1;
        let route = order.route_id.clone();
        engine.workspaces.put_back(route, workspace.saved());
    }
    Ok(outcome)
}

/// An error of a computation; errors of the store keep their type.
fn of_computation(error: anyhow::Error) -> ReleaseError {
    match error.downcast::<StoreError>() {
        Ok(error) => ReleaseError::Store(error),
        Err(error) => ReleaseError::Failed(error),
    }
}
