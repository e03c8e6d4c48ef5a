//! Long work that somebody asked for: its requests and results, as values.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::removal_records::{RemovalRequest, RemovalResult};
use crate::ids::{AlertId, OperationId, RouteId};
use crate::model::{
    Actor, AlertAction, DecisionResult, DismissReason, OperationKind, OperationStatus,
};

/// Long work that somebody asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct OperationRecord {
    /// By which it is asked for.
    pub id: OperationId,
    /// The route that it changes; `None` if it is about alerts of several routes.
    pub route_id: Option<RouteId>,
    /// What is to be done.
    pub request: OperationRequest,
    /// How far it has come.
    pub status: OperationStatus,
    /// What a removal has removed, while the map is made anew without it.
    pub removed: Option<RemovalResult>,
    /// What was done; `None` unless it succeeded.
    pub result: Option<OperationResult>,
    /// Why it failed.
    pub reason: Option<String>,
    /// When it was asked for.
    pub asked_at: Timestamp,
    /// When it ended.
    pub ended_at: Option<Timestamp>,
}

/// What an operation is to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OperationRequest {
    /// Take uploads out of a route.
    Removal(RemovalRequest),
    /// Carry out decisions about alerts.
    Decisions(DecisionsRequest),
}

impl OperationRecord {
    /// Whether it is about nothing but routes that somebody may see.
    pub fn is_within(&self, sees: impl Fn(&RouteId) -> bool) -> bool {
        match (&self.route_id, &self.request) {
            (Some(route), _) => sees(route),
            (None, OperationRequest::Decisions(request)) => {
                let routes = request.routes.as_ref();
                routes.is_some_and(|routes| routes.iter().all(sees))
            }
            (None, OperationRequest::Removal(_)) => false,
        }
    }
}

impl OperationRequest {
    /// Its kind.
    pub fn kind(&self) -> OperationKind {
        match self {
            Self::Removal(_) => OperationKind::Removal,
            Self::Decisions(_) => OperationKind::Decisions,
        }
    }

    /// Whether it only says what it would do.
    pub fn is_dry_run(&self) -> bool {
        matches!(self, Self::Removal(RemovalRequest { dry_run: true, .. }))
    }
}

/// What an operation has done.
#[derive(Debug, Clone, PartialEq)]
pub enum OperationResult {
    /// What was removed.
    Removal(RemovalResult),
    /// What became of each decision, in the order of the request.
    Decisions(Vec<DecisionOutcome>),
}

/// Decisions that somebody sent together.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecisionsRequest {
    /// In the order in which they were sent; no alert twice.
    pub decisions: Vec<DecisionRequest>,
    /// Who decided, as they say.
    pub by: String,
    /// Whose request it is, for the audit.
    #[serde(with = "actor_text")]
    pub actor: Actor,
    /// The routes that they are limited to: alerts of others are unknown; `None` for all.
    pub routes: Option<Vec<RouteId>>,
}

impl DecisionsRequest {
    /// Whether an alert of this route may be decided about.
    pub fn covers(&self, route: &RouteId) -> bool {
        let routes = self.routes.as_ref();
        routes.is_none_or(|routes| routes.contains(route))
    }
}

/// One of several decisions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecisionRequest {
    /// The alert.
    pub alert_id: AlertId,
    /// What to do.
    pub action: AlertAction,
    /// The [`super::AlertRecord::decision_revision`]s of which the alert must have one; `None` for any.
    pub decision_revisions: Option<Vec<i64>>,
    /// Why, for people.
    pub note: Option<String>,
    /// Why it is dismissed.
    pub reason: Option<DismissReason>,
}

/// What became of one of several decisions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecisionOutcome {
    /// The alert.
    pub alert_id: AlertId,
    /// What was to be done.
    pub action: AlertAction,
    /// Whether it was.
    pub result: DecisionResult,
    /// Why it was not, for people; `None` if it was, or had been before.
    pub detail: Option<String>,
    /// The version of the map that began with it; `None` if none did.
    pub map_version: Option<i64>,
}

/// An actor by name and address.
mod actor_text {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::ids::KeyId;
    use crate::model::Actor;

    #[derive(Serialize, Deserialize)]
    struct Text {
        name: String,
        address: Option<String>,
        key: Option<KeyId>,
    }

    pub(super) fn serialize<S: Serializer>(actor: &Actor, to: S) -> Result<S::Ok, S::Error> {
        let text = Text {
            name: actor.name().to_owned(),
            address: actor.address().map(str::to_owned),
            key: actor.key(),
        };
        text.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Actor, D::Error> {
        let Text { name, address, key } = Text::deserialize(from)?;
        Actor::of(&name, address, key).ok_or_else(|| D::Error::custom("nobody has this name"))
    }
}
