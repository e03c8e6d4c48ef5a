//! What people decide about an alert.

use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::Response;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::body::{AlertBody, etag, with_etag};
use super::known::{known_alert, unknown_alert};
use super::reason::{Why, decider};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::if_match::is_among;
use crate::api::parameters::{AlertParam, IfAlertMatches};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::DecisionProblems;
use crate::api::upload::SmallJson;
use crate::ids::AlertId;
use crate::model::{Actor, AlertAction, DismissReason};
use crate::pipeline::{DecisionError, Order};

/// The details of a decision; an empty body counts as `{}`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"note": "new rack, as planned", "by": "J. Kovács"}))]
pub(in crate::api) struct AlertDecision {
    /// Why, for people.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
    /// Why the alert is dismissed; only with `dismiss`.
    reason: Option<DismissReason>,
    /// Who decided, if no key identifies them; `anonymous` by default. Ignored for people who have signed in:
    /// the history has their own name.
    #[schema(
        min_length = 1,
        max_length = 100,
        pattern = r"^[^\x00-\x1f\x7f-\x9f]*$"
    )]
    by: Option<String>,
}

/// A request that decides about an alert.
type Posted = (
    ApiPath<AlertId>,
    NoQuery,
    Actor,
    HeaderMap,
    SmallJson<AlertDecision>,
);

/// The ETags that a decision may be about: it must name the revision that its maker has seen.
fn wanted_tags(headers: &HeaderMap) -> Result<&str, Problem> {
    let wanted = headers.get(header::IF_MATCH).ok_or_else(|| {
        let detail = "send If-Match with the alert's ETag (its decision_revision in quotes), so that \
                      nobody decides about a state of the alert that they have not seen";
        Problem::new(ProblemKind::PreconditionRequired, detail).at("If-Match")
    })?;
    Ok(wanted.to_str().unwrap_or_default())
}

/// The problem of a decision that was refused.
pub(super) fn refused(error: DecisionError, action: AlertAction) -> Problem {
    let detail = error.detail(action);
    match error {
        DecisionError::UnknownAlert => unknown_alert(),
        DecisionError::Changed(_) => {
            Problem::new(ProblemKind::PreconditionFailed, detail).at("If-Match")
        }
        DecisionError::NotAllowed(_) => Problem::new(ProblemKind::TransitionNotAllowed, detail),
        DecisionError::Busy => Problem::new(ProblemKind::Overloaded, detail),
        DecisionError::Store(error) => error.into(),
        DecisionError::Failed(_) => Problem::internal(error),
    }
}

/// Carries a decision out if the alert has one of the ETags that the request names.
async fn decide(
    state: &ApiState,
    action: AlertAction,
    (ApiPath(id), _, actor, headers, SmallJson(decision)): Posted,
) -> Result<Response, Problem> {
    let by = decider(&actor, decision.by)?;
    let why = Why::checked(action, by, decision.note, decision.reason)?;
    let alert = known_alert(state, id).await?;
    if !is_among(wanted_tags(&headers)?, &etag(&alert)) {
        return Err(refused(DecisionError::Changed(Box::new(alert)), action));
    }
    let order = Order {
        alert_id: id,
        decision_revision: alert.decision_revision,
        action,
        actor,
        by: why.by,
        note: why.note,
        reason: why.reason,
        at: Timestamp::now(),
    };
    let decided = state.decisions.decide(order).await;
    decided.map_err(|error| refused(error, action))?;
    Ok(with_etag(known_alert(state, id).await?))
}

/// Acknowledge an alert.
///
/// Shows others that somebody is looking into it. The map does not change.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/acknowledge", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn acknowledge_alert(
    State(state): State<ApiState>,
    posted: Posted,
) -> Result<Response, Problem> {
    decide(&state, AlertAction::Acknowledge, posted).await
}

/// Accept a change into the map.
///
/// Retires the loop closures that contradict it, optimises their sub-graph again, and begins the next version
/// of the map. Answers once the new map is stored.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/accept", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn accept_alert(
    State(state): State<ApiState>,
    posted: Posted,
) -> Result<Response, Problem> {
    decide(&state, AlertAction::Accept, posted).await
}

/// Dismiss an alert.
///
/// The map does not change, and the same change at the same place is not raised again.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/dismiss", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn dismiss_alert(
    State(state): State<ApiState>,
    posted: Posted,
) -> Result<Response, Problem> {
    decide(&state, AlertAction::Dismiss, posted).await
}

/// Reopen an alert.
///
/// For an alert that was acknowledged, dismissed or resolved too early.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/reopen", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn reopen_alert(
    State(state): State<ApiState>,
    posted: Posted,
) -> Result<Response, Problem> {
    decide(&state, AlertAction::Reopen, posted).await
}

/// Undo an acceptance.
///
/// The next version of the map shows the old state again, and the alert returns to the status that it had
/// before.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/undo", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn undo_alert(
    State(state): State<ApiState>,
    posted: Posted,
) -> Result<Response, Problem> {
    decide(&state, AlertAction::Undo, posted).await
}
