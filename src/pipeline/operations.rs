//! The tasks that carry out long-running operations: those of each kind one after the other.

use std::sync::{Arc, Mutex, PoisonError};

use anyhow::bail;
use tokio::sync::Notify;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::decide::Decisions;
use super::engine::{is_passing, now};
use super::rebuild::Rebuild;
use super::remove::{Then, remove};
use crate::ids::{OperationId, RouteId};
use crate::model::{Actor, OperationKind};
use crate::store::{
    DecisionsRequest, OperationRecord, OperationRequest, OperationResult, RemovalRequest,
    RemovalResult, Store, StoreError,
};

/// How long after a failure of the store an operation is tried again.
const PAUSE: std::time::Duration = std::time::Duration::from_secs(1);

/// Accepts long-running operations; cheap to clone.
#[derive(Clone)]
pub struct Operations {
    store: Store,
    removals: Lane,
    decisions: Lane,
}

/// Operations of one kind, which are carried out one after the other.
#[derive(Clone)]
struct Lane {
    kind: OperationKind,
    queued: Arc<Notify>,
    /// How much of the present one is done, from 0 to 1.
    share: Arc<Mutex<Option<(OperationId, f64)>>>,
}

impl Lane {
    fn of(kind: OperationKind) -> Self {
        Self {
            kind,
            queued: Arc::default(),
            share: Arc::default(),
        }
    }

    fn note_share(&self, id: OperationId, share: f64) {
        let mut noted = self.share.lock().unwrap_or_else(PoisonError::into_inner);
        *noted = Some((id, share));
    }
}

impl Operations {
    pub(super) fn new(store: &Store) -> Self {
        Self {
            store: store.clone(),
            removals: Lane::of(OperationKind::Removal),
            decisions: Lane::of(OperationKind::Decisions),
        }
    }

    /// Queues an operation on one route or (`None`) on several. It is carried out after those of its kind that
    /// were queued before, and resumed after a restart of the service.
    ///
    /// # Errors
    /// [`StoreError::UnknownRoute`].
    pub async fn ask_for(
        &self,
        route: Option<&RouteId>,
        request: OperationRequest,
        by: &Actor,
    ) -> Result<OperationId, StoreError> {
        let id = OperationId(Uuid::now_v7());
        let kind = request.kind();
        self.store.ask_for(id, route, request, by, now()).await?;
        match kind {
            OperationKind::Removal => self.removals.queued.notify_one(),
            OperationKind::Decisions => self.decisions.queued.notify_one(),
        }
        Ok(id)
    }

    /// How much of an operation that has not ended is done, from 0 to 1.
    pub fn share_done(&self, id: OperationId) -> f64 {
        let lanes = [&self.removals, &self.decisions].into_iter();
        let mut noted = lanes.filter_map(|lane| {
            let share = lane.share.lock().unwrap_or_else(PoisonError::into_inner);
            share.filter(|(of, _)| *of == id)
        });
        noted.next().map_or(0.0, |(_, share)| share)
    }

    /// Starts the tasks that carry operations out, those of each kind one after the other, until the service
    /// stops.
    pub(super) fn start(
        &self,
        decisions: &Decisions,
        stopping: &CancellationToken,
    ) -> Vec<JoinHandle<()>> {
        let start = |lane: &Lane| {
            let carrying_out = CarryingOut {
                decisions: decisions.clone(),
                lane: lane.clone(),
                stopping: stopping.clone(),
            };
            tokio::spawn(carrying_out.run())
        };
        vec![start(&self.removals), start(&self.decisions)]
    }
}

/// The task that carries out the operations of one kind.
struct CarryingOut {
    decisions: Decisions,
    lane: Lane,
    stopping: CancellationToken,
}

impl CarryingOut {
    async fn run(self) {
        let store = &self.decisions.engine.store;
        while !self.stopping.is_cancelled() {
            match store.next_operation(self.lane.kind).await {
                Ok(Some(operation)) => self.carry_out(&operation).await,
                Ok(None) => tokio::select! {
                    () = self.lane.queued.notified() => {}
                    () = self.stopping.cancelled() => {}
                },
                Err(error) => {
                    tracing::warn!(%error, "operations cannot be read");
                    self.pause().await;
                }
            }
        }
    }

    async fn carry_out(&self, operation: &OperationRecord) {
        let (id, kind) = (operation.id, self.lane.kind.name());
        let route = operation.route_id.as_ref().map(RouteId::as_str);
        let done = match &operation.request {
            OperationRequest::Removal(request) => self.remove(operation, request).await,
            OperationRequest::Decisions(request) => decide(&self.decisions, id, request).await,
        };
        let Err(error) = done else {
            tracing::info!(kind, route, operation = %id, "an operation has ended");
            return;
        };
        if self.stopping.is_cancelled() {
            return;
        }
        let reason = format!("{error:#}");
        tracing::error!(kind, route, operation = %id, reason, "an operation failed");
        let is_passing = is_passing(&error);
        let ended = match is_passing {
            true => Ok(()),
            false => {
                let store = &self.decisions.engine.store;
                store.end_operation(id, Err(reason), now()).await
            }
        };
        if is_passing || ended.is_err() {
            self.pause().await;
        }
    }

    /// Takes uploads out of a map at once, and then makes it anew without them. If the service stops in
    /// between, it begins to make it anew when the operation is resumed.
    async fn remove(
        &self,
        operation: &OperationRecord,
        request: &RemovalRequest,
    ) -> anyhow::Result<()> {
        let engine = &self.decisions.engine;
        let store = &engine.store;
        if operation.removed.is_none() {
            remove(engine, operation, request, Then::IsRebuilt, now()).await?;
        }
        let noted = store.operation(operation.id).await?;
        let Some((route, removed)) = noted.and_then(|noted| noted.route_id.zip(noted.removed))
        else {
            return Ok(());
        };
        let rebuild = Rebuild {
            engine: engine.clone(),
            route: route.clone(),
            operation: operation.id,
            removed: removed.clone(),
            once: None,
        };
        let (lane, stopping, id) = (self.lane.clone(), self.stopping.clone(), operation.id);
        let rebuilt = rebuild.carry_out(Box::new(move |share| {
            lane.note_share(id, share);
            match stopping.is_cancelled() {
                true => bail!("the service is stopping"),
                false => Ok(()),
            }
        }));
        match rebuilt.await {
            Err(error) if !self.stopping.is_cancelled() => {
                let reason = format!("{error:#}");
                tracing::warn!(%route, operation = %id, reason, "a map was not made anew");
                let result = RemovalResult {
                    not_rebuilt_because: Some(reason),
                    ..removed
                };
                let result = Ok(OperationResult::Removal(result));
                Ok(store.end_operation(id, result, now()).await?)
            }
            rebuilt => rebuilt,
        }
    }

    async fn pause(&self) {
        let _ = tokio::time::timeout(PAUSE, self.stopping.cancelled()).await;
    }
}

/// Carries out decisions and ends their operation. If the service stops in between, what was carried out
/// stands, and is `already_done` when the operation is resumed.
async fn decide(
    decisions: &Decisions,
    id: OperationId,
    request: &DecisionsRequest,
) -> anyhow::Result<()> {
    let outcomes = OperationResult::Decisions(decisions.decide_each(request).await?);
    let store = &decisions.engine.store;
    Ok(store.end_operation(id, Ok(outcomes), now()).await?)
}
