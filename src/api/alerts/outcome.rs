//! The outcome of one of several decisions.

use serde::Serialize;
use utoipa::ToSchema;

use crate::api::problem::{Problem, ProblemBody, ProblemKind};
use crate::model::{AlertAction, DecisionResult};
use crate::store::DecisionOutcome;

/// The outcome of a decision.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DecisionOutcome)]
pub(in crate::api) struct DecisionOutcomeBody {
    /// The alert.
    #[schema(format = "uuid")]
    pub id: String,
    /// The requested action.
    pub action: AlertAction,
    /// Whether it was carried out.
    pub result: DecisionResult,
    /// The version of the map that an `accept` began; null if none did.
    #[schema(required)]
    pub map_version: Option<i64>,
    /// Why it was not carried out; null if it was, now or before.
    #[schema(required)]
    pub problem: Option<ProblemBody>,
}

impl From<DecisionOutcome> for DecisionOutcomeBody {
    fn from(outcome: DecisionOutcome) -> Self {
        let kind = match outcome.result {
            DecisionResult::Done | DecisionResult::AlreadyDone => None,
            DecisionResult::Changed => Some(ProblemKind::PreconditionFailed),
            DecisionResult::NotAllowed => Some(ProblemKind::TransitionNotAllowed),
            DecisionResult::Unknown => Some(ProblemKind::NotFound),
            DecisionResult::Failed => Some(ProblemKind::Overloaded),
        };
        let detail = outcome.detail.unwrap_or_default();
        Self {
            id: outcome.alert_id.to_string(),
            action: outcome.action,
            result: outcome.result,
            map_version: outcome.map_version,
            problem: kind.map(|kind| Problem::new(kind, detail).body("")),
        }
    }
}
