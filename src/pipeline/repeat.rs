//! The inputs of a route's journal, repeated one after the other.

use std::collections::BTreeSet;
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use futures::future::BoxFuture;
use jiff::Timestamp;
use serde::Serialize;

use super::decide::{DecisionError, Decisions, Order};
use super::engine::Engine;
use super::release::{ReleaseError, ReleaseOrder};
use super::remove::{Then, remove};
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

/// Makes a map anew as of the input with a key, as a removal once did, at the time that it did.
pub(super) type RebuildAgain =
    fn(Engine, RouteId, OperationId, i64, Timestamp) -> BoxFuture<'static, anyhow::Result<()>>;

/// What is repeated.
#[derive(Clone, Copy)]
pub(super) enum Manner<'a> {
    /// Everything, removals included.
    AsItWas(RebuildAgain),
    /// Everything as if these uploads had never come.
    Without(&'a BTreeSet<BatchId>),
}

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

/// Whether a route's journal begins with the route, and not after batches that an earlier version processed.
pub(super) async fn is_whole(store: &Store, route: &RouteId) -> anyhow::Result<bool> {
    let first = store.inputs(route, 0, 1).await?;
    Ok(matches!(first.first(), Some(first) if matches!(first.input, Input::Settings(_))))
}

/// A route's inputs on their way into its map once more.
pub(super) struct Repeat<'a> {
    pub engine: Engine,
    pub replayed: Replayed,
    decisions: Decisions,
    /// The store that holds the journal, which another one's map may be made from.
    journal: &'a Store,
    route: &'a RouteId,
    manner: Manner<'a>,
    /// The key of the last input that was repeated.
    last: i64,
}

impl<'a> Repeat<'a> {
    pub fn new(engine: Engine, journal: &'a Store, route: &'a RouteId, manner: Manner<'a>) -> Self {
        Self {
            decisions: Decisions::new(engine.clone()),
            engine,
            replayed: Replayed::default(),
            journal,
            route,
            manner,
            last: 0,
        }
    }

    /// Repeats the inputs that follow, up to the one with the key `last`. `on_progress` learns after each how
    /// many were repeated; its error ends it.
    ///
    /// # Errors
    /// If an input cannot be repeated.
    pub async fn repeat_until(
        &mut self,
        last: i64,
        on_progress: impl Fn(u64) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        while self.last < last {
            let page = self.journal.inputs(self.route, self.last, PAGE).await?;
            if page.is_empty() {
                bail!("the journal of route {} ends early", self.route);
            }
            for record in page.into_iter().take_while(|record| record.key <= last) {
                self.last = record.key;
                let repeated = self.repeat(record).await;
                repeated.with_context(|| format!("input {} of route {}", self.last, self.route))?;
                self.replayed.inputs += 1;
                on_progress(self.replayed.inputs)?;
            }
        }
        Ok(())
    }

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
                if self
                    .left_out()
                    .is_some_and(|left_out| left_out.contains(&batch))
                {
                    return Ok(());
                }
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
            Input::Removal { .. } if self.left_out().is_some() => {}
            Input::Removal { operation, batches } => self.remove(operation, batches, at).await?,
            Input::Rebuilt { operation } => self.rebuild(operation, record.key, at).await?,
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
        let job = match self.left_out() {
            Some(left_out) => store.claim_without(self.route, input, left_out, at).await?,
            None => store.claim_again(self.route, input, at).await?,
        };
        let entries = job.as_ref().map_or(0, |job| job.entries.len());
        self.replayed.batches += entries as u64;
        if self.left_out().is_none() {
            self.replayed.without_body += input.batches.len().saturating_sub(entries) as u64;
        }
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
        remove(&self.engine, &operation, &request, Then::Ends, at).await
    }

    /// Repeats that the map was made anew, as of the input with a key; nothing is new where what was removed
    /// is left out from the beginning.
    async fn rebuild(&self, operation: OperationId, key: i64, at: Timestamp) -> anyhow::Result<()> {
        match self.manner {
            Manner::AsItWas(rebuild) => {
                let engine = self.engine.clone();
                rebuild(engine, self.route.clone(), operation, key, at).await
            }
            Manner::Without(_) => Ok(()),
        }
    }

    fn left_out(&self) -> Option<&'a BTreeSet<BatchId>> {
        match self.manner {
            Manner::AsItWas(_) => None,
            Manner::Without(left_out) => Some(left_out),
        }
    }
}
