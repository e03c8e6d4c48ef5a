//! Taking uploads out of a route: the computation, and the task that carries operations out.

use std::collections::BTreeSet;
use std::sync::Arc;

use anyhow::{Context, anyhow};
use jiff::Timestamp;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::alerts::{fold_into, take_out_passes};
use super::engine::{Engine, now};
use super::findings::{findings, observed_everywhere};
use super::result::changes_of;
use super::settle::{recall_named, solve_recalled};
use super::shift::PosesBefore;
use super::workspace::Workspace;
use crate::ids::{EdgeId, OperationId, RouteId, TripId};
use crate::model::Actor;
use crate::store::{
    OperationRecord, Removable, Removal, RemovalRequest, RemovalResult, Store, StoreError,
};

/// How often a removal is computed before what happens in between counts as a failure.
const COMPUTATIONS_MAX: usize = 4;
/// How long after a failure of the store an operation is tried again.
const PAUSE: std::time::Duration = std::time::Duration::from_secs(1);

/// Takes what people want to have removed; cheap to clone.
#[derive(Clone)]
pub struct Removals {
    store: Store,
    asked: Arc<Notify>,
}

impl Removals {
    pub(super) fn new(store: &Store) -> Self {
        Self {
            store: store.clone(),
            asked: Arc::new(Notify::new()),
        }
    }

    /// Notes a removal, which is carried out after those that were asked for before, also if the
    /// service stops meanwhile.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`].
    pub async fn ask_for(
        &self,
        route: &RouteId,
        request: RemovalRequest,
        by: &Actor,
    ) -> Result<OperationId, StoreError> {
        let id = OperationId(Uuid::now_v7());
        self.store.ask_for(id, route, request, by, now()).await?;
        self.asked.notify_one();
        Ok(id)
    }

    /// Carries operations out one after the other until the service stops.
    pub(super) async fn carry_out(self, engine: Engine, stopping: CancellationToken) {
        while !stopping.is_cancelled() {
            match self.store.next_operation().await {
                Ok(Some(operation)) => self.carry_out_one(&engine, &operation, &stopping).await,
                Ok(None) => tokio::select! {
                    () = self.asked.notified() => {}
                    () = stopping.cancelled() => {}
                },
                Err(error) => {
                    tracing::warn!(%error, "operations cannot be read");
                    pause(&stopping).await;
                }
            }
        }
    }

    async fn carry_out_one(
        &self,
        engine: &Engine,
        operation: &OperationRecord,
        stopping: &CancellationToken,
    ) {
        let (id, route) = (operation.id, &operation.route_id);
        let Err(error) = remove(engine, operation, now()).await else {
            tracing::info!(%route, operation = %id, "a removal has ended");
            return;
        };
        let reason = format!("{error:#}");
        tracing::error!(%route, operation = %id, reason, "a removal failed");
        let of_store = error.downcast_ref::<StoreError>();
        let is_passing = of_store.is_some_and(StoreError::is_passing);
        let ended = match is_passing {
            true => Ok(()),
            false => self.store.end_operation(id, Err(reason), now()).await,
        };
        if is_passing || ended.is_err() {
            pause(stopping).await;
        }
    }
}

async fn pause(stopping: &CancellationToken) {
    let _ = tokio::time::timeout(PAUSE, stopping.cancelled()).await;
}

/// Computes a removal and writes it; a dry run only says what it would do.
pub(super) async fn remove(
    engine: &Engine,
    operation: &OperationRecord,
    at: Timestamp,
) -> anyhow::Result<()> {
    let Engine {
        store, workspaces, ..
    } = engine;
    let (route, request) = (&operation.route_id, &operation.request);
    let _turn = engine.turn(route).await;
    for _ in 0..COMPUTATIONS_MAX {
        let removable = store.removable(route, &request.meant).await?;
        let recalled = recall_named(store, route, &removable.nodes, &removable.edges).await?;
        let mut workspace = workspaces.take(store, route).await?;
        let own = operation.clone();
        let computed = engine.compute(move || {
            solve_recalled(&mut workspace.map, &recalled);
            take_out(workspace, &own, removable, at)
        });
        let (workspace, removal) = computed.await??;
        if request.dry_run {
            let ended = store.end_operation(operation.id, Ok(removal.result), removal.at);
            return Ok(ended.await?);
        }
        if store.apply_removal(removal).await? {
            workspaces.put_back(route.clone(), workspace.saved());
            return Ok(());
        }
    }
    Err(anyhow!("the route has moved on meanwhile"))
}

/// Takes what is removable out of the map, and asks what is left everywhere anew.
fn take_out(
    mut workspace: Workspace,
    operation: &OperationRecord,
    removable: Removable,
    at: Timestamp,
) -> anyhow::Result<(Workspace, Removal)> {
    let Removable { nodes, edges, .. } = &removable;
    let before = PosesBefore::of(&workspace.map, 0.0, |keyframe| {
        nodes.binary_search(&keyframe.node).is_ok()
    });
    let base_revision = workspace.revision;
    let stays = |edge: &EdgeId| edges.binary_search(edge).is_err();
    workspace.closures.retain(|closure| stays(&closure.edge_id));
    workspace.given.retain(stays);
    workspace
        .settled_closures
        .retain(|closure| stays(&closure.id));
    workspace.calibrations.forget(&removable.trips);
    let taken_out = workspace.map.take_out(nodes, edges);
    taken_out.context("what is left of the map does not fit together")?;
    let keyframes = workspace.map.keyframes().iter();
    let trips: BTreeSet<TripId> = keyframes.map(|keyframe| keyframe.trip.clone()).collect();
    workspace.vehicles.retain(|trip, _| trips.contains(trip));

    let (mut changed_nodes, changed_edges) = changes_of(&mut workspace);
    changed_nodes.retain(|change| nodes.binary_search(&change.id).is_err());
    let observed = observed_everywhere(&mut workspace);
    let found = findings(&workspace, observed);
    let mut alerts = fold_into(&mut workspace, &operation.route_id, &found, &[], at);
    take_out_passes(&mut workspace, nodes, at, &mut alerts);
    let count = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
    let result = RemovalResult {
        batches: count(removable.batches.len()),
        nodes: count(nodes.len()),
        edges: count(edges.len()),
        alerts: count(alerts.len()),
        moved_m: before.farthest_m(&workspace.map),
    };
    let note = operation.request.note.as_deref();
    let removal = Removal {
        operation: operation.id,
        route_id: operation.route_id.clone(),
        base_revision,
        changed_nodes,
        changed_edges,
        alerts,
        reason: note.unwrap_or("taken out of the map").to_owned(),
        erase: operation.request.erase,
        result,
        at,
        removable,
    };
    Ok((workspace, removal))
}
