//! What people decide about alerts: checked, computed, and saved in one transaction.

use anyhow::anyhow;
use jiff::Timestamp;

use super::accept::{accept, read_undo, undo};
use super::decision_revision;
use super::engine::{Engine, as_kept};
use super::settle::{recall_named, solve_recalled};
use super::workspace::Workspace;
use crate::change::{AlertAction, AlertStatus, ChangeKind};
use crate::ids::{AlertId, EdgeId, NodeId};
use crate::model::{Actor, DismissReason};
use crate::store::{AlertRecord, Decided, Decision, HistoryEntry, StoreError};

/// A decision is computed anew so often while batches or other decisions come in between.
pub(super) const TRIES_MAX: usize = 20;

/// What somebody wants done with an alert.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// The alert.
    pub alert_id: AlertId,
    /// Its [`AlertRecord::decision_revision`] as they have seen it.
    pub decision_revision: i64,
    /// What to do.
    pub action: AlertAction,
    /// Whose request it is, for the audit.
    pub actor: Actor,
    /// Who wants it, as they say.
    pub by: String,
    /// Why, for people.
    pub note: Option<String>,
    /// Why it is dismissed; `None` with every other action.
    pub reason: Option<DismissReason>,
    /// When they decided.
    pub at: Timestamp,
}

/// Why a decision was not taken; nothing has changed then.
#[derive(Debug, thiserror::Error)]
pub enum DecisionError {
    /// There is no such alert.
    #[error("there is no such alert")]
    UnknownAlert,
    /// What the decision is about is not as it was seen.
    #[error("the alert has changed since it was read")]
    Changed(Box<AlertRecord>),
    /// The alert's status or kind does not allow it.
    #[error("this cannot be done with the alert as it is")]
    NotAllowed(Box<AlertRecord>),
    /// Batches and other decisions came in between again and again.
    #[error("the route changes too quickly")]
    Busy,
    /// The store did not take it.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The computation failed.
    #[error("the decision could not be computed")]
    Failed(#[source] anyhow::Error),
}

/// Takes decisions; cheap to clone.
#[derive(Clone)]
pub struct Decisions {
    pub(super) engine: Engine,
}

/// A decision with the map that it leaves behind.
struct Computed {
    workspace: Workspace,
    decision: Decision,
}

impl Decisions {
    pub(super) fn new(engine: Engine) -> Self {
        Self { engine }
    }

    /// Carries an order out and returns the alert as it is then. Once begun it is finished, even
    /// if whoever asked goes away. Accepting and undoing wait for the route's batch under way.
    ///
    /// # Errors
    /// [`DecisionError`]; nothing has changed then.
    pub async fn decide(&self, order: Order) -> Result<AlertRecord, DecisionError> {
        let own = self.clone();
        let task = tokio::spawn(async move { own.carry_out(&order).await });
        task.await
            .map_err(|error| DecisionError::Failed(error.into()))?
    }

    async fn carry_out(&self, order: &Order) -> Result<AlertRecord, DecisionError> {
        for _ in 0..TRIES_MAX {
            let alert = self.engine.store.alert(order.alert_id).await?;
            let alert = alert.ok_or(DecisionError::UnknownAlert)?;
            if alert.decision_revision != order.decision_revision {
                return Err(DecisionError::Changed(Box::new(alert)));
            }
            if !is_allowed(&alert, order.action) {
                return Err(DecisionError::NotAllowed(Box::new(alert)));
            }
            let decided = match order.action.leads_to() {
                Some(AlertStatus::Accepted) | None => self.change_map(order, alert).await?,
                Some(status) => self.change_status(order, &alert, status).await?,
            };
            if let Some(alert) = decided {
                return Ok(alert);
            }
        }
        Err(DecisionError::Busy)
    }

    /// Writes what leaves the map alone; `None` if something came in between.
    async fn change_status(
        &self,
        order: &Order,
        alert: &AlertRecord,
        status: AlertStatus,
    ) -> Result<Option<AlertRecord>, DecisionError> {
        let route = self.engine.store.route(&alert.route_id).await?;
        let base_revision = route.ok_or(DecisionError::UnknownAlert)?.revision;
        let alert = next(alert, order, status);
        let decision = Decision {
            base_revision,
            action: order.action,
            actor: order.actor.clone(),
            alert: alert.clone(),
            map: None,
        };
        if self.engine.store.apply_decision(decision).await? == Decided::Stale {
            return Ok(None);
        }
        self.engine.workspaces.note_decision(base_revision, &alert);
        Ok(Some(alert))
    }

    /// Writes what changes the map; `None` if something came in between.
    async fn change_map(
        &self,
        order: &Order,
        alert: AlertRecord,
    ) -> Result<Option<AlertRecord>, DecisionError> {
        let route = alert.route_id.clone();
        let _turn = self.engine.turn(&route).await;
        let Engine {
            store, workspaces, ..
        } = &self.engine;
        let undo = match order.action {
            AlertAction::Undo => store.acceptance(alert.id).await?,
            _ => None,
        };
        let undo = undo.map(|acceptance| acceptance.undo);
        let (nodes, edges) = named(&alert, undo.as_deref()).map_err(of_computation)?;
        let recalled = recall_named(store, &route, &nodes, &edges).await?;
        let taken = workspaces.take(store, &route).await;
        let mut workspace = taken.map_err(of_computation)?;
        let own = order.clone();
        let computed = self.engine.compute(move || {
            solve_recalled(&mut workspace.map, &recalled);
            compute(workspace, &alert, &own, undo.as_deref())
        });
        let computed = computed.await.and_then(|computed| computed);
        let Computed {
            mut workspace,
            decision,
        } = computed.map_err(of_computation)?;
        let alert = decision.alert.clone();
        if self.engine.store.apply_decision(decision).await? == Decided::Stale {
            return Ok(None);
        }
        workspace.replace_alert(&alert);
        workspaces.put_back(route, workspace.saved());
        Ok(Some(alert))
    }
}

/// Whether somebody may do this with the alert as it is. A vehicle that is suspected and a segment
/// where the map is wrong are no changes of the world: there is nothing to take into the map.
pub fn is_allowed(alert: &AlertRecord, action: AlertAction) -> bool {
    let is_change = !matches!(
        alert.evidence.kind,
        ChangeKind::VehicleSuspect | ChangeKind::MapMismatch
    );
    alert.status.allows(action) && (is_change || action != AlertAction::Accept)
}

/// The nodes and edges of which a map needs what may have left it, to take a change in or out.
fn named(
    alert: &AlertRecord,
    undo_bytes: Option<&[u8]>,
) -> anyhow::Result<(Vec<NodeId>, Vec<EdgeId>)> {
    match undo_bytes {
        Some(bytes) => Ok(read_undo(bytes)?.named()),
        None => Ok((Vec::new(), alert.evidence.edges.clone())),
    }
}

fn compute(
    mut workspace: Workspace,
    alert: &AlertRecord,
    order: &Order,
    undo_bytes: Option<&[u8]>,
) -> anyhow::Result<Computed> {
    let base_revision = workspace.revision;
    let (status, map) = match order.action {
        AlertAction::Undo => {
            let bytes = undo_bytes.ok_or_else(|| anyhow!("the accepted change is gone"))?;
            let restored = read_undo(bytes)?;
            let map = undo(&mut workspace, alert.id, &restored)?;
            (restored.status, map)
        }
        _ => (AlertStatus::Accepted, accept(&mut workspace, alert)?),
    };
    workspace.map.settle_screen();
    let decision = Decision {
        base_revision,
        action: order.action,
        actor: order.actor.clone(),
        alert: next(alert, order, status),
        map: Some(map),
    };
    Ok(Computed {
        workspace,
        decision,
    })
}

/// The alert's next revision.
fn next(alert: &AlertRecord, order: &Order, status: AlertStatus) -> AlertRecord {
    let mut next = alert.clone();
    next.revision += 1;
    next.status = status;
    next.updated_at = as_kept(order.at).max(alert.updated_at);
    next.history.push(HistoryEntry {
        status,
        at: next.updated_at,
        by: order.by.clone(),
        note: order.note.clone(),
        reason: order.reason,
    });
    decision_revision::count(Some(alert), &mut next);
    next
}

/// An error of a computation; the store's own keep their name.
fn of_computation(error: anyhow::Error) -> DecisionError {
    match error.downcast::<StoreError>() {
        Ok(error) => DecisionError::Store(error),
        Err(error) => DecisionError::Failed(error),
    }
}
