//! Rebuilds a route's map from its journal of inputs, in a copy of the database.

use futures::future::BoxFuture;
use jiff::Timestamp;

use super::engine::Engine;
use super::options::PipelineOptions;
use super::rebuild::{Once, Rebuild};
use super::repeat::{Manner, Repeat, Replayed, is_whole};
use crate::ids::{OperationId, RouteId};
use crate::store::{RemovalResult, Store};

/// Rebuilds a route's map. The store is a copy on which no pipeline runs; `on_progress` learns
/// after each input how many of how many were repeated. `None`: the route's journal begins after
/// batches that an earlier version processed, and its map is left as it is.
///
/// # Errors
/// If an input cannot be repeated; the copy is of no use then.
pub async fn replay(
    store: &Store,
    route: &RouteId,
    options: PipelineOptions,
    on_progress: &(dyn Fn(u64, u64) + Sync),
) -> anyhow::Result<Option<Replayed>> {
    if !is_whole(store, route).await? {
        return Ok(None);
    }
    let engine = Engine::new(store, options)?;
    let mut replay = Repeat::new(engine, store, route, Manner::AsItWas(rebuild_again));
    let inputs = store.begin_rebuild(route).await?;
    let repeated = replay.repeat_until(inputs.last, |done| {
        on_progress(done, inputs.count);
        Ok(())
    });
    repeated.await?;
    store.end_rebuild(route).await?;
    Ok(Some(replay.replayed))
}

fn rebuild_again(
    engine: Engine,
    route: RouteId,
    operation: OperationId,
    key: i64,
    at: Timestamp,
) -> BoxFuture<'static, anyhow::Result<()>> {
    let rebuild = Rebuild {
        engine,
        route,
        operation,
        removed: RemovalResult::default(),
        once: Some(Once { key, at }),
    };
    rebuild.carry_out(Box::new(|_| Ok(())))
}
