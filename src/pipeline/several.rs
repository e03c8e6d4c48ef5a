//! Decisions about several alerts at once: what is accepted on one route makes one version of its map.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::decide::{DecisionError, Decisions, Order, TRIES_MAX};
use super::engine::now;
use crate::change::AlertAction;
use crate::ids::RouteId;
use crate::model::DecisionResult;
use crate::store::{AlertRecord, DecisionOutcome, DecisionRequest, DecisionsRequest, StoreError};

/// The outcome of an acceptance: the version of the map that began with it, or why it was refused.
type Accepted = Result<i64, DecisionError>;

impl Decisions {
    /// Carries out several decisions and returns the outcome of each, in their order. Decisions other than
    /// acceptances come first, one after the other, then acceptances, route by route: all of one route make
    /// one version of its map. It is finished even if the caller goes away.
    ///
    /// # Errors
    /// [`StoreError`] if the store fails meanwhile. What was carried out stands: repeated, these
    /// decisions are answered [`DecisionResult::AlreadyDone`].
    pub async fn decide_all(
        &self,
        request: DecisionsRequest,
    ) -> Result<Vec<DecisionOutcome>, StoreError> {
        let own = self.clone();
        let task = tokio::spawn(async move { own.decide_each(&request).await });
        task.await.map_err(|_| StoreError::Unavailable)?
    }

    pub(super) async fn decide_each(
        &self,
        request: &DecisionsRequest,
    ) -> Result<Vec<DecisionOutcome>, StoreError> {
        let at = now();
        let mut outcomes = BTreeMap::new();
        let mut accepting: BTreeMap<RouteId, Vec<(usize, Order)>> = BTreeMap::new();
        for (place, decision) in request.decisions.iter().enumerate() {
            let (order, route) = match self.order(request, decision, at).await? {
                Ok(order) => order,
                Err(outcome) => {
                    outcomes.insert(place, outcome);
                    continue;
                }
            };
            if decision.action == AlertAction::Accept {
                accepting.entry(route).or_default().push((place, order));
                continue;
            }
            let decided = self.carry_out(&order).await.map(|_| None);
            outcomes.insert(place, outcome(&order, decided)?);
        }
        for (_, mut group) in accepting {
            // In the order in which the store keeps them.
            group.sort_by_key(|(_, order)| order.alert_id);
            let (places, orders): (Vec<usize>, Vec<Order>) = group.into_iter().unzip();
            let accepted = self.accept_together(&orders).await?;
            for ((place, order), accepted) in places.into_iter().zip(&orders).zip(accepted) {
                outcomes.insert(place, outcome(order, accepted.map(Some))?);
            }
        }
        Ok(outcomes.into_values().collect())
    }

    /// The order for a decision and the route of its alert, or the outcome if it is already clear.
    async fn order(
        &self,
        request: &DecisionsRequest,
        decision: &DecisionRequest,
        at: Timestamp,
    ) -> Result<Result<(Order, RouteId), DecisionOutcome>, StoreError> {
        let outcome = |result, detail| DecisionOutcome {
            alert_id: decision.alert_id,
            action: decision.action,
            result,
            detail,
            map_version: None,
        };
        let alert = self.engine.store.alert(decision.alert_id).await?;
        let Some(alert) = alert.filter(|alert| request.covers(&alert.route_id)) else {
            let detail = DecisionError::UnknownAlert.detail(decision.action);
            return Ok(Err(outcome(DecisionResult::Unknown, Some(detail))));
        };
        if decision.action.leads_to() == Some(alert.status) {
            return Ok(Err(outcome(DecisionResult::AlreadyDone, None)));
        }
        let seen = decision.decision_revisions.as_ref();
        if seen.is_some_and(|seen| !seen.contains(&alert.decision_revision)) {
            let detail = DecisionError::Changed(Box::new(alert)).detail(decision.action);
            return Ok(Err(outcome(DecisionResult::Changed, Some(detail))));
        }
        let order = Order {
            alert_id: alert.id,
            decision_revision: alert.decision_revision,
            action: decision.action,
            actor: request.actor.clone(),
            by: request.by.clone(),
            note: decision.note.clone(),
            reason: decision.reason,
            at,
        };
        Ok(Ok((order, alert.route_id)))
    }

    /// Accepts those alerts of one route that have not changed, as one version of its map.
    pub(super) async fn accept_together(
        &self,
        orders: &[Order],
    ) -> Result<Vec<Accepted>, StoreError> {
        let mut outcomes: BTreeMap<usize, Accepted> = BTreeMap::new();
        for _ in 0..TRIES_MAX {
            let (mut places, mut alerts): (Vec<usize>, Vec<AlertRecord>) = Default::default();
            for (place, order) in orders.iter().enumerate() {
                if outcomes.contains_key(&place) {
                    continue;
                }
                match self.decidable(order).await {
                    Ok(alert) => {
                        places.push(place);
                        alerts.push(alert);
                    }
                    Err(DecisionError::Store(error)) => return Err(error),
                    Err(refused) => {
                        outcomes.insert(place, Err(refused));
                    }
                }
            }
            if places.is_empty() {
                break;
            }
            let own: Vec<Order> = places.iter().map(|place| orders[*place].clone()).collect();
            match self.change_map(&own, alerts).await {
                Ok(Some(changed)) => {
                    outcomes.extend(places.iter().map(|place| (*place, Ok(changed.map_version))));
                }
                Ok(None) => {}
                Err(DecisionError::Store(error)) => return Err(error),
                Err(failed) => {
                    let cause = format!("{:#}", anyhow::Error::new(failed));
                    let failed = || DecisionError::Failed(anyhow::anyhow!(cause.clone()));
                    outcomes.extend(places.iter().map(|place| (*place, Err(failed()))));
                }
            }
        }
        let places = 0..orders.len();
        let outcomes =
            places.map(|place| outcomes.remove(&place).unwrap_or(Err(DecisionError::Busy)));
        Ok(outcomes.collect())
    }
}

fn outcome(
    order: &Order,
    decided: Result<Option<i64>, DecisionError>,
) -> Result<DecisionOutcome, StoreError> {
    let (result, detail, map_version) = match decided {
        Ok(map_version) => (DecisionResult::Done, None, map_version),
        Err(DecisionError::Store(error)) => return Err(error),
        Err(error) => {
            let result = match &error {
                DecisionError::UnknownAlert => DecisionResult::Unknown,
                DecisionError::Changed(_) => DecisionResult::Changed,
                DecisionError::NotAllowed(_) => DecisionResult::NotAllowed,
                _ => DecisionResult::Failed,
            };
            if let DecisionError::Failed(cause) = &error {
                let (alert, cause) = (order.alert_id, format!("{cause:#}"));
                tracing::error!(%alert, cause, "a decision failed");
            }
            (result, Some(error.detail(order.action)), None)
        }
    };
    Ok(DecisionOutcome {
        alert_id: order.alert_id,
        action: order.action,
        result,
        detail,
        map_version,
    })
}
