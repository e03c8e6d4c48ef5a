//! Decisions of people about alerts: all of one in one transaction, or nothing.

use serde::Serialize;
use sqlx::SqliteConnection;

use super::Store;
use super::acceptances;
use super::alert_records::{
    AcceptanceChange, AcceptedChange, AlertAction, AlertRecord, Decided, Decision, HistoryEntry,
};
use super::alert_rows::write_alerts;
use super::audit::{self, Change};
use super::body::SealedBody;
use super::columns::{json_text, micros};
use super::error::StoreError;
use super::graph_rows::{update_edges, update_nodes};
use super::inputs::{self, Input};
use super::map_versions::{self, Beginning, SealedPicture};
use super::records::{EdgeChange, NodeChange};
use super::request::Request;
use super::results::count_blocks;
use crate::model::{Actor, AlertStatus, DismissReason, VersionAction};

impl Store {
    /// Writes a decision, all or nothing.
    ///
    /// # Errors
    /// [`StoreError::InvalidResult`] if the decision contradicts itself or the store.
    pub async fn apply_decision(&self, decision: Decision) -> Result<Decided, StoreError> {
        let sealed = tokio::task::spawn_blocking(|| ApplyDecision::seal(decision));
        let request = sealed.await.map_err(|_| StoreError::Unavailable)??;
        self.work(request).await
    }
}

/// Applies a decision if neither the route nor the alert has moved on.
pub(super) struct ApplyDecision {
    base_revision: i64,
    action: AlertAction,
    actor: Actor,
    alert: AlertRecord,
    map: Option<SealedMapDecision>,
}

struct SealedMapDecision {
    accepted: Option<(AcceptedChange, SealedBody)>,
    changed_nodes: Vec<NodeChange>,
    changed_edges: Vec<EdgeChange>,
    superseded: SealedPicture,
    max_displacement_m: f64,
}

impl ApplyDecision {
    /// Compresses what is large; milliseconds of work for a large map.
    ///
    /// # Errors
    /// [`StoreError::Compression`].
    pub(super) fn seal(decision: Decision) -> Result<Self, StoreError> {
        let map = decision.map.map(|map| {
            let accepted = match map.accepted {
                AcceptanceChange::Removed => None,
                AcceptanceChange::Added(acceptance) => {
                    Some((acceptance.change, SealedBody::seal(&acceptance.undo)?))
                }
            };
            Ok::<_, StoreError>(SealedMapDecision {
                accepted,
                changed_nodes: map.changed_nodes,
                changed_edges: map.changed_edges,
                superseded: SealedPicture::seal(map.superseded)?,
                max_displacement_m: map.max_displacement_m,
            })
        });
        Ok(Self {
            base_revision: decision.base_revision,
            action: decision.action,
            actor: decision.actor,
            alert: decision.alert,
            map: map.transpose()?,
        })
    }
}

impl Request for ApplyDecision {
    type Outcome = Decided;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Decided, StoreError> {
        let Some(route_key) = self.route_key(transaction).await? else {
            return Ok(Decided::Stale);
        };
        let alerts = std::slice::from_ref(&self.alert);
        write_alerts(transaction, route_key, alerts).await?;
        if let Some(map) = &self.map {
            self.change_map(transaction, route_key, map).await?;
        }
        raise_revision(transaction, route_key, micros(self.alert.updated_at)).await?;
        self.note_input(transaction, route_key).await?;
        self.note(transaction).await?;
        Ok(Decided::Committed)
    }
}

impl ApplyDecision {
    /// The route, if it and the alert are still what the decision was made on.
    async fn route_key(
        &self,
        transaction: &mut SqliteConnection,
    ) -> Result<Option<i64>, StoreError> {
        let route_key = sqlx::query_scalar(
            "SELECT route_key FROM routes JOIN alerts USING (route_key) \
             WHERE routes.id = ? AND routes.revision = ? AND alerts.id = ? \
             AND alerts.revision = ?",
        )
        .bind(self.alert.route_id.as_str())
        .bind(self.base_revision)
        .bind(self.alert.id.to_string())
        .bind(self.alert.revision - 1)
        .fetch_optional(transaction)
        .await?;
        Ok(route_key)
    }

    /// Writes the audit's row: the last two entries of the alert's history.
    async fn note(&self, transaction: &mut SqliteConnection) -> Result<(), StoreError> {
        let mut history = self.alert.history.iter().rev();
        let (after, before) = (history.next(), history.next());
        let change = Change {
            at: self.alert.updated_at,
            actor: &self.actor,
            action: self.action.into(),
            route_id: Some(self.alert.route_id.as_str()),
            subject: &self.alert.id.to_string(),
            before: before.map(entry_text).transpose()?,
            after: after.map(entry_text).transpose()?,
        };
        audit::write(transaction, change).await
    }

    async fn note_input(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<(), StoreError> {
        let Some(entry) = self.alert.history.last() else {
            return Ok(());
        };
        let input = Input::Decision {
            alert: self.alert.id,
            action: self.action,
            by: entry.by.clone(),
            note: entry.note.clone(),
            reason: entry.reason,
        };
        inputs::note(transaction, route_key, self.alert.updated_at, &input).await
    }

    async fn change_map(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
        map: &SealedMapDecision,
    ) -> Result<(), StoreError> {
        update_nodes(transaction, route_key, &map.changed_nodes).await?;
        update_edges(transaction, route_key, &map.changed_edges).await?;
        let action = match &map.accepted {
            Some((change, undo)) => {
                acceptances::insert(transaction, route_key, change, undo).await?;
                VersionAction::Accept
            }
            None => {
                if !acceptances::remove(transaction, self.alert.id).await? {
                    let what = format!("alert {} has not been accepted", self.alert.id);
                    return Err(StoreError::InvalidResult(what));
                }
                VersionAction::Undo
            }
        };
        let entry = self.alert.history.last();
        let next = Beginning {
            at_us: micros(self.alert.updated_at),
            decided: Some((self.alert.id, action)),
            by: entry.map(|entry| entry.by.as_str()),
            note: entry.and_then(|entry| entry.note.as_deref()),
            max_displacement_m: map.max_displacement_m,
        };
        map_versions::file(transaction, route_key, &map.superseded, next.at_us).await?;
        map_versions::begin(transaction, route_key, &next).await
    }
}

/// A status that an alert took, as the audit has it.
fn entry_text(entry: &HistoryEntry) -> Result<String, StoreError> {
    #[derive(Serialize)]
    struct Entry<'a> {
        status: AlertStatus,
        by: &'a str,
        note: Option<&'a str>,
        #[serde(skip_serializing_if = "Option::is_none")]
        reason: Option<DismissReason>,
    }
    json_text(&Entry {
        status: entry.status,
        by: &entry.by,
        note: entry.note.as_deref(),
        reason: entry.reason,
    })
}

/// Counts a change of a route's map, and its blocks.
pub(super) async fn raise_revision(
    transaction: &mut SqliteConnection,
    route_key: i64,
    at_us: i64,
) -> Result<(), StoreError> {
    count_blocks(transaction, route_key).await?;
    sqlx::query("UPDATE routes SET revision = revision + 1, updated_at_us = ? WHERE route_key = ?")
        .bind(at_us)
        .bind(route_key)
        .execute(transaction)
        .await?;
    Ok(())
}
