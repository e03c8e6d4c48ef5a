//! The task that carries out long-running operations, one after the other.

use std::sync::Arc;

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::decide::Decisions;
use super::engine::now;
use super::remove::remove;
use crate::ids::{OperationId, RouteId};
use crate::model::Actor;
use crate::store::{
    DecisionsRequest, OperationRecord, OperationRequest, OperationResult, Store, StoreError,
};

/// How long after a failure of the store an operation is tried again.
const PAUSE: std::time::Duration = std::time::Duration::from_secs(1);

/// Accepts long-running operations; cheap to clone.
#[derive(Clone)]
pub struct Operations {
    store: Store,
    queued: Arc<Notify>,
}

impl Operations {
    pub(super) fn new(store: &Store) -> Self {
        Self {
            store: store.clone(),
            queued: Arc::new(Notify::new()),
        }
    }

    /// Queues an operation on one route or (`None`) on several. It is carried out after those queued before,
    /// and resumed after a restart of the service.
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
        self.store.ask_for(id, route, request, by, now()).await?;
        self.queued.notify_one();
        Ok(id)
    }

    /// Carries operations out one after the other until the service stops.
    pub(super) async fn carry_out(self, decisions: Decisions, stopping: CancellationToken) {
        while !stopping.is_cancelled() {
            match self.store.next_operation().await {
                Ok(Some(operation)) => self.carry_out_one(&decisions, &operation, &stopping).await,
                Ok(None) => tokio::select! {
                    () = self.queued.notified() => {}
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
        decisions: &Decisions,
        operation: &OperationRecord,
        stopping: &CancellationToken,
    ) {
        let (id, kind) = (operation.id, operation.request.kind().name());
        let route = operation.route_id.as_ref().map(RouteId::as_str);
        let done = match &operation.request {
            OperationRequest::Removal(request) => {
                remove(&decisions.engine, operation, request, now()).await
            }
            OperationRequest::Decisions(request) => decide(decisions, id, request).await,
        };
        let Err(error) = done else {
            tracing::info!(kind, route, operation = %id, "an operation has ended");
            return;
        };
        let reason = format!("{error:#}");
        tracing::error!(kind, route, operation = %id, reason, "an operation failed");
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

async fn pause(stopping: &CancellationToken) {
    let _ = tokio::time::timeout(PAUSE, stopping.cancelled()).await;
}
