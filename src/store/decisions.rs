//! Decisions of people about alerts: all of one in one transaction, or nothing.

use serde::Serialize;
use sqlx::SqliteConnection;

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
use super::inputs::{self, AcceptedInput, Input};
use super::map_versions::{self, Beginning, SealedPicture};
use super::records::{EdgeChange, NodeChange};
use super::request::Request;
use super::results::count_blocks;
use super::{Store, news};
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

/// Applies a decision if neither the route nor its alerts have moved on.
pub(super) struct ApplyDecision {
    base_revision: i64,
    action: AlertAction,
    actor: Actor,
    alerts: Vec<AlertRecord>,
    map: Option<SealedMapDecision>,
}

struct SealedMapDecision {
    /// `None` where an acceptance is taken back.
    accepted: Option<Vec<(AcceptedChange, SealedBody)>>,
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
                AcceptanceChange::Added(acceptances) => {
                    let sealed = acceptances.into_iter().map(|acceptance| {
                        Ok((acceptance.change, SealedBody::seal(&acceptance.undo)?))
                    });
                    Some(sealed.collect::<Result<_, StoreError>>()?)
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
            alerts: decision.alerts,
            map: map.transpose()?,
        })
    }
}

impl Request for ApplyDecision {
    type Outcome = Decided;
    const QUEUES_JOBS: bool = false;

    async fn execute(&self, transaction: &mut SqliteConnection) -> Result<Decided, StoreError> {
        let Some(first) = self.alerts.first() else {
            return Err(StoreError::InvalidResult("it is about no alert".to_owned()));
        };
        let Some(route_key) = self.route_key(transaction, first).await? else {
            return Ok(Decided::Stale);
        };
        for alert in &self.alerts[1..] {
            if self.route_key(transaction, alert).await? != Some(route_key) {
                return Ok(Decided::Stale);
            }
        }
        write_alerts(transaction, route_key, &self.alerts).await?;
        if let Some(map) = &self.map {
            self.change_map(transaction, route_key, first, map).await?;
        }
        raise_revision(transaction, route_key, micros(first.updated_at)).await?;
        if let Some(input) = self.input() {
            inputs::note(transaction, route_key, first.updated_at, &input).await?;
        }
        for alert in &self.alerts {
            self.note(transaction, alert).await?;
        }
        Ok(Decided::Committed)
    }

    fn committed(&self, decided: &Decided) {
        if *decided == Decided::Committed {
            news::decided(self.action, &self.actor, &self.alerts);
        }
    }
}

impl ApplyDecision {
    /// The route of an alert, if both are still what the decision was made on.
    async fn route_key(
        &self,
        transaction: &mut SqliteConnection,
        alert: &AlertRecord,
    ) -> Result<Option<i64>, StoreError> {
        let route_key = sqlx::query_scalar(
            "SELECT route_key FROM routes JOIN alerts USING (route_key) \
             WHERE routes.id = $1 AND routes.revision = $2 AND alerts.id = $3 \
             AND alerts.revision = $4",
        )
        .bind(alert.route_id.as_str())
        .bind(self.base_revision)
        .bind(alert.id.to_string())
        .bind(alert.revision - 1)
        .fetch_optional(transaction)
        .await?;
        Ok(route_key)
    }

    /// Writes the audit's row: the last two entries of the alert's history.
    async fn note(
        &self,
        transaction: &mut SqliteConnection,
        alert: &AlertRecord,
    ) -> Result<(), StoreError> {
        let mut history = alert.history.iter().rev();
        let (after, before) = (history.next(), history.next());
        let change = Change {
            at: alert.updated_at,
            actor: &self.actor,
            action: self.action.into(),
            route_id: Some(alert.route_id.as_str()),
            subject: &alert.id.to_string(),
            before: before.map(entry_text).transpose()?,
            after: after.map(entry_text).transpose()?,
        };
        audit::write(transaction, change).await
    }

    /// What it is in the journal of inputs.
    fn input(&self) -> Option<Input> {
        let entry = |alert: &AlertRecord| alert.history.last().cloned();
        if let [alert] = self.alerts.as_slice() {
            let entry = entry(alert)?;
            return Some(Input::Decision {
                alert: alert.id,
                action: self.action,
                by: entry.by,
                note: entry.note,
                reason: entry.reason,
            });
        }
        let accepted = self.alerts.iter().filter_map(|alert| {
            let entry = entry(alert)?;
            Some(AcceptedInput {
                alert: alert.id,
                by: entry.by,
                note: entry.note,
            })
        });
        Some(Input::AcceptedTogether {
            alerts: accepted.collect(),
        })
    }

    async fn change_map(
        &self,
        transaction: &mut SqliteConnection,
        route_key: i64,
        first: &AlertRecord,
        map: &SealedMapDecision,
    ) -> Result<(), StoreError> {
        update_nodes(transaction, route_key, &map.changed_nodes).await?;
        update_edges(transaction, route_key, &map.changed_edges).await?;
        let action = match &map.accepted {
            Some(accepted) => {
                for (change, undo) in accepted {
                    acceptances::insert(transaction, route_key, change, undo).await?;
                }
                VersionAction::Accept
            }
            None => {
                if !acceptances::remove(transaction, first.id).await? {
                    let what = format!("alert {} has not been accepted", first.id);
                    return Err(StoreError::InvalidResult(what));
                }
                VersionAction::Undo
            }
        };
        let entry = first.history.last();
        let next = Beginning {
            at_us: micros(first.updated_at),
            decided: Some((first.id, action)),
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
    sqlx::query(
        "UPDATE routes SET revision = revision + 1, updated_at_us = $1 WHERE route_key = $2",
    )
    .bind(at_us)
    .bind(route_key)
    .execute(transaction)
    .await?;
    Ok(())
}
