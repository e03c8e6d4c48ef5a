//! Decisions about alerts: checked, computed, and saved in one transaction.

use anyhow::anyhow;
use jiff::Timestamp;

use super::accept::{accept, read_undo, undo};
use super::archive::{reactivate_named, solve_reactivated};
use super::decision_revision;
use super::engine::{Engine, as_kept};
use super::workspace::Workspace;
use crate::change::{AlertAction, AlertStatus};
use crate::ids::{AlertId, EdgeId, NodeId, RouteId};
use crate::model::{Actor, DismissReason};
use crate::store::{AlertRecord, Decided, Decision, HistoryEntry, StoreError};

/// How often a decision is computed again because the route changed meanwhile, before it is refused.
pub(super) const TRIES_MAX: usize = 20;

/// A decision that somebody sends.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// The alert.
    pub alert_id: AlertId,
    /// The [`AlertRecord::decision_revision`] that they have read.
    pub decision_revision: i64,
    /// What to do.
    pub action: AlertAction,
    /// Who sent the request, for the audit.
    pub actor: Actor,
    /// Who decided, as the request states.
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
    /// The alert has changed since it was read.
    #[error("the alert has changed since it was read")]
    Changed(Box<AlertRecord>),
    /// The alert's status or kind does not allow it.
    #[error("this cannot be done with the alert as it is")]
    NotAllowed(Box<AlertRecord>),
    /// Batches and other decisions kept changing the route.
    #[error("the route changes too quickly")]
    Busy,
    /// The store failed or refused the decision.
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

/// A decision with the map after it.
struct Computed {
    workspace: Workspace,
    decision: Decision,
}

/// A committed change of the map.
pub(super) struct ChangedMap {
    /// The alerts after the change.
    alerts: Vec<AlertRecord>,
    /// The version of the map that began with it.
    pub map_version: i64,
}

impl Decisions {
    pub(super) fn new(engine: Engine) -> Self {
        Self { engine }
    }

    /// Forgets the map in memory of a route that was deleted.
    pub fn forget_map(&self, route: &RouteId) {
        self.engine.workspaces.forget(route);
    }

    /// Carries out an order and returns the alert after it. It is finished even if the caller goes away.
    /// Accepting and undoing wait for the batch that the route is processing.
    ///
    /// # Errors
    /// [`DecisionError`]; nothing has changed then.
    pub async fn decide(&self, order: Order) -> Result<AlertRecord, DecisionError> {
        let own = self.clone();
        let task = tokio::spawn(async move { own.carry_out(&order).await });
        task.await
            .map_err(|error| DecisionError::Failed(error.into()))?
    }

    pub(super) async fn carry_out(&self, order: &Order) -> Result<AlertRecord, DecisionError> {
        for _ in 0..TRIES_MAX {
            let alert = self.decidable(order).await?;
            let decided = match order.action.leads_to() {
                Some(AlertStatus::Accepted) | None => {
                    let changed = self.change_map(std::slice::from_ref(order), vec![alert]);
                    changed.await?.and_then(|mut changed| changed.alerts.pop())
                }
                Some(status) => self.change_status(order, &alert, status).await?,
            };
            if let Some(alert) = decided {
                return Ok(alert);
            }
        }
        Err(DecisionError::Busy)
    }

    /// The alert of an order, if it has not changed and allows the action.
    pub(super) async fn decidable(&self, order: &Order) -> Result<AlertRecord, DecisionError> {
        let alert = self.engine.store.alert(order.alert_id).await?;
        let alert = alert.ok_or(DecisionError::UnknownAlert)?;
        if alert.decision_revision != order.decision_revision {
            return Err(DecisionError::Changed(Box::new(alert)));
        }
        if !is_allowed(&alert, order.action) {
            return Err(DecisionError::NotAllowed(Box::new(alert)));
        }
        Ok(alert)
    }

    /// Writes a decision that does not change the map; `None` if the route changed meanwhile.
    async fn change_status(
        &self,
        order: &Order,
        alert: &AlertRecord,
        status: AlertStatus,
    ) -> Result<Option<AlertRecord>, DecisionError> {
        let route = self.engine.store.route(&alert.route_id).await?;
        let base_revision = route.ok_or(DecisionError::UnknownAlert)?.revision;
        let alert = next(alert, order, status, alert.updated_at);
        let decision = Decision {
            base_revision,
            action: order.action,
            actor: order.actor.clone(),
            alerts: vec![alert.clone()],
            map: None,
        };
        if self.engine.store.apply_decision(decision).await? == Decided::Stale {
            return Ok(None);
        }
        self.engine.workspaces.note_decision(base_revision, &alert);
        Ok(Some(alert))
    }

    /// Writes a decision that changes the map: one undo, or acceptances of alerts of one route; `None` if the
    /// route changed meanwhile. `orders[k]` is about `alerts[k]`.
    pub(super) async fn change_map(
        &self,
        orders: &[Order],
        alerts: Vec<AlertRecord>,
    ) -> Result<Option<ChangedMap>, DecisionError> {
        let Some((order, first)) = orders.first().zip(alerts.first()) else {
            return Err(DecisionError::Failed(anyhow!("there is no order")));
        };
        let route = first.route_id.clone();
        let _turn = self.engine.turn(&route).await;
        let Engine {
            store, workspaces, ..
        } = &self.engine;
        let undo = match order.action {
            AlertAction::Undo => store.acceptance(first.id).await?,
            _ => None,
        };
        let undo = undo.map(|acceptance| acceptance.undo);
        let (nodes, edges) = named(&alerts, undo.as_deref()).map_err(of_computation)?;
        let reactivated = reactivate_named(store, &route, &nodes, &edges).await?;
        let taken = workspaces.take(store, &route).await;
        let mut workspace = taken.map_err(of_computation)?;
        let own = orders.to_vec();
        let computed = self.engine.compute(move || {
            solve_reactivated(&mut workspace.map, &reactivated);
            compute(workspace, &alerts, &own, undo.as_deref())
        });
        let computed = computed.await.and_then(|computed| computed);
        let Computed {
            mut workspace,
            decision,
        } = computed.map_err(of_computation)?;
        let alerts = decision.alerts.clone();
        if self.engine.store.apply_decision(decision).await? == Decided::Stale {
            return Ok(None);
        }
        for alert in &alerts {
            workspace.replace_alert(alert);
        }
        let map_version = workspace.map_version;
        workspaces.put_back(route, workspace.saved());
        Ok(Some(ChangedMap {
            alerts,
            map_version,
        }))
    }
}

/// Whether an alert allows an action. Suspected vehicles and misplaced segments are no changes of the world:
/// they cannot be accepted into the map.
pub fn is_allowed(alert: &AlertRecord, action: AlertAction) -> bool {
    let is_change = alert.evidence.kind.is_of_world();
    alert.status.allows(action) && (is_change || action != AlertAction::Accept)
}

/// The nodes and edges that must be active to accept or undo a change.
fn named(
    alerts: &[AlertRecord],
    undo_bytes: Option<&[u8]>,
) -> anyhow::Result<(Vec<NodeId>, Vec<EdgeId>)> {
    match undo_bytes {
        Some(bytes) => Ok(read_undo(bytes)?.named()),
        None => {
            let edges = alerts.iter().flat_map(|alert| &alert.evidence.edges);
            Ok((Vec::new(), edges.copied().collect()))
        }
    }
}

fn compute(
    mut workspace: Workspace,
    alerts: &[AlertRecord],
    orders: &[Order],
    undo_bytes: Option<&[u8]>,
) -> anyhow::Result<Computed> {
    let base_revision = workspace.revision;
    let [order, ..] = orders else {
        return Err(anyhow!("there is no order"));
    };
    let (status, map) = match (order.action, alerts) {
        (AlertAction::Undo, [alert]) => {
            let bytes = undo_bytes.ok_or_else(|| anyhow!("the accepted change is gone"))?;
            let restored = read_undo(bytes)?;
            let map = undo(&mut workspace, alert.id, &restored)?;
            (restored.status, map)
        }
        _ => (AlertStatus::Accepted, accept(&mut workspace, alerts)?),
    };
    workspace.map.settle_screen();
    // One time for all: a replay knows only that of their input.
    let latest = alerts.iter().map(|alert| alert.updated_at).max();
    let decided = alerts.iter().zip(orders).map(|(alert, order)| {
        let not_before = latest.unwrap_or(alert.updated_at);
        next(alert, order, status, not_before)
    });
    let decision = Decision {
        base_revision,
        action: order.action,
        actor: order.actor.clone(),
        alerts: decided.collect(),
        map: Some(map),
    };
    Ok(Computed {
        workspace,
        decision,
    })
}

/// The alert's next revision, no earlier than `not_before`.
fn next(
    alert: &AlertRecord,
    order: &Order,
    status: AlertStatus,
    not_before: Timestamp,
) -> AlertRecord {
    let mut next = alert.clone();
    next.revision += 1;
    next.status = status;
    next.updated_at = as_kept(order.at).max(not_before);
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

/// An error of a computation; errors of the store keep their type.
pub(super) fn of_computation(error: anyhow::Error) -> DecisionError {
    match error.downcast::<StoreError>() {
        Ok(error) => DecisionError::Store(error),
        Err(error) => DecisionError::Failed(error),
    }
}
