//! Rebuilds a route's map from its journal of inputs, in a copy of the database.

use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use jiff::Timestamp;
use serde::Serialize;

use super::decide::{DecisionError, Decisions, Order};
use super::engine::Engine;
use super::options::PipelineOptions;
use super::release::{ReleaseError, ReleaseOrder};
use super::remove::remove;
use super::worker::compute;
use crate::ids::{AlertId, BatchId, OperationId, RouteId};
use crate::model::{Actor, AlertAction};
use crate::solver::Interrupt;
use crate::store::{
    AcceptedInput, Applied, Input, InputRecord, JobInput, Meant, OperationRequest, Quarantine,
    Store, VersionRelease,
};

/// Inputs of one read.
const PAGE: u32 = 256;

/// The inputs of a rebuilt map.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Replayed {
    /// Entries of the journal.
    pub inputs: u64,
    /// Batches that were processed, each as often as it was before.
    pub batches: u64,
    /// Batches that were left out, because their bodies are not kept any more.
    pub without_body: u64,
    /// Decisions that were left out, because the alert is not there or does not allow them.
    pub decisions_left_out: Vec<AlertId>,
    /// Versions that were not released or retired, because the map has come to others.
    pub versions_left_out: Vec<i64>,
}

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
    let first = store.inputs(route, 0, 1).await?;
    if !matches!(first.first(), Some(first) if matches!(first.input, Input::Settings(_))) {
        return Ok(None);
    }
    let engine = Engine::new(store, options)?;
    let mut replay = Replay {
        decisions: Decisions::new(engine.clone()),
        engine,
        route,
        replayed: Replayed::default(),
    };
    let inputs = store.begin_rebuild(route).await?;
    let mut after = 0;
    while after < inputs.last {
        let mut page = store.inputs(route, after, PAGE).await?;
        page.retain(|record| record.key <= inputs.last);
        for record in page {
            after = record.key;
            let repeated = replay.repeat(record).await;
            repeated.with_context(|| format!("input {after} of route {route}"))?;
            replay.replayed.inputs += 1;
            on_progress(replay.replayed.inputs, inputs.count);
        }
    }
    store.end_rebuild(route).await?;
    Ok(Some(replay.replayed))
}

struct Replay<'a> {
    engine: Engine,
    decisions: Decisions,
    route: &'a RouteId,
    replayed: Replayed,
}

impl Replay<'_> {
    async fn repeat(&mut self, record: InputRecord) -> anyhow::Result<()> {
        let (store, route, at) = (&self.engine.store, self.route, record.at);
        match record.input {
            Input::Settings(settings) => store.set_again(route, settings, at).await?,
            Input::Job(job) => self.process(&job, at).await?,
            Input::KeptOut {
                batch,
                status,
                reason,
            } => {
                let kept_out = store.keep_out_again(route, &batch, status, reason, at);
                kept_out.await?;
            }
            Input::Decision {
                alert,
                action,
                by,
                note,
                reason,
            } => {
                let order = |decision_revision| Order {
                    alert_id: alert,
                    decision_revision,
                    action,
                    actor: Actor::System,
                    by,
                    note,
                    reason,
                    at,
                };
                self.decide(alert, order).await?;
            }
            Input::AcceptedTogether { alerts } => self.accept_together(alerts, at).await?,
            Input::Removal { operation, batches } => self.remove(operation, batches, at).await?,
            Input::VehicleQuarantined { vehicle, note } => {
                let quarantine = Some(Quarantine { since: at, note });
                let put = store.put_quarantine(route, &vehicle, quarantine, &Actor::System, at);
                put.await?;
            }
            Input::VehicleReleased { vehicle } => {
                let put = store.put_quarantine(route, &vehicle, None, &Actor::System, at);
                put.await?;
            }
            Input::VersionReleased { version, by, note } => {
                let order = ReleaseOrder {
                    route_id: route.clone(),
                    version,
                    actor: Actor::System,
                    release: VersionRelease { at, by, note },
                };
                self.release(order).await?;
            }
            Input::VersionRetired { version } => {
                let retired = store.retire_version(route, version, &Actor::System, at);
                if !retired.await? {
                    self.replayed.versions_left_out.push(version);
                }
            }
        }
        Ok(())
    }

    async fn release(&mut self, order: ReleaseOrder) -> anyhow::Result<()> {
        let version = order.version;
        match self.decisions.release(order).await {
            Ok(_) => {}
            Err(
                ReleaseError::UnknownVersion | ReleaseError::NotAllowed(_) | ReleaseError::Empty,
            ) => {
                self.replayed.versions_left_out.push(version);
            }
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    async fn process(&mut self, input: &JobInput, at: Timestamp) -> anyhow::Result<()> {
        let Engine {
            store, workspaces, ..
        } = &self.engine;
        let job = store.claim_again(self.route, input, at).await?;
        let entries = job.as_ref().map_or(0, |job| job.entries.len());
        self.replayed.batches += entries as u64;
        self.replayed.without_body += input.batches.len().saturating_sub(entries) as u64;
        let Some(job) = job else { return Ok(()) };
        let (workspace, result) =
            compute(&self.engine, &Arc::new(job), &Interrupt::default()).await?;
        match store.apply_result(result).await? {
            Applied::Committed => workspaces.put_back(self.route.clone(), workspace.saved()),
            Applied::Stale => bail!("somebody else writes to the copy"),
        }
        Ok(())
    }

    async fn decide(
        &mut self,
        alert_id: AlertId,
        order: impl FnOnce(i64) -> Order,
    ) -> anyhow::Result<()> {
        let Some(alert) = self.engine.store.alert(alert_id).await? else {
            self.replayed.decisions_left_out.push(alert_id);
            return Ok(());
        };
        let order = order(alert.decision_revision);
        match self.decisions.decide(order).await {
            Ok(_) => {}
            Err(DecisionError::NotAllowed(_)) => self.replayed.decisions_left_out.push(alert_id),
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    /// Accepts alerts once more, those that are there and allow it.
    async fn accept_together(
        &mut self,
        accepted: Vec<AcceptedInput>,
        at: Timestamp,
    ) -> anyhow::Result<()> {
        let mut orders = Vec::with_capacity(accepted.len());
        for AcceptedInput { alert, by, note } in accepted {
            let Some(record) = self.engine.store.alert(alert).await? else {
                self.replayed.decisions_left_out.push(alert);
                continue;
            };
            orders.push(Order {
                alert_id: alert,
                decision_revision: record.decision_revision,
                action: AlertAction::Accept,
                actor: Actor::System,
                by,
                note,
                reason: None,
                at,
            });
        }
        let accepted = self.decisions.accept_together(&orders).await?;
        for (order, accepted) in orders.iter().zip(accepted) {
            match accepted {
                Ok(_) => {}
                Err(DecisionError::NotAllowed(_)) => {
                    self.replayed.decisions_left_out.push(order.alert_id);
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    async fn remove(
        &mut self,
        operation: OperationId,
        batches: Vec<BatchId>,
        at: Timestamp,
    ) -> anyhow::Result<()> {
        let recorded = self.engine.store.operation(operation).await?;
        let operation = recorded.ok_or_else(|| anyhow!("operation {operation} is gone"))?;
        let OperationRequest::Removal(mut request) = operation.request.clone() else {
            bail!("operation {} removes nothing", operation.id);
        };
        // As it was then: batches that came later may be meant as well.
        request.meant = Meant::Batches(batches);
        remove(&self.engine, &operation, &request, at).await
    }
}
