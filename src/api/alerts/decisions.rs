//! What people decide about alerts.

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::Response;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::body::etag;
use super::{AlertBody, known_alert, unknown_alert, with_etag};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::if_match::is_among;
use crate::api::note::checked_note;
use crate::api::parameters::{AlertParam, IfAlertMatches};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::DecisionProblems;
use crate::api::upload::small_json;
use crate::change::AlertAction;
use crate::ids::AlertId;
use crate::model::{Actor, DismissReason};
use crate::pipeline::{DecisionError, Order};
use crate::store::SYSTEM;

const NAME_CHARS_MAX: usize = 100;
/// Who decided, where nobody says so.
const UNNAMED: &str = "anonymous";

/// What goes with a decision; an empty body is as good as `{}`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"note": "new rack, as planned", "by": "J. Kovács"}))]
pub(in crate::api) struct AlertDecision {
    /// Why, for people.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
    /// Why it is dismissed; with `dismiss` alone.
    reason: Option<DismissReason>,
    /// Who decided, if no key says it; `anonymous` if left out. Ignored of those who have signed in: their
    /// own name stands in the history.
    #[schema(
        min_length = 1,
        max_length = 100,
        pattern = r"^[^\x00-\x1f\x7f-\x9f]*$"
    )]
    by: Option<String>,
}

/// Who decides, and why.
pub(super) struct Why {
    pub by: String,
    pub note: Option<String>,
    pub reason: Option<DismissReason>,
}

impl Why {
    pub(super) fn checked(
        action: AlertAction,
        by: String,
        note: Option<String>,
        reason: Option<DismissReason>,
    ) -> Result<Self, Problem> {
        if reason.is_some() && action != AlertAction::Dismiss {
            let detail = "a reason goes with dismiss alone: write a note instead";
            return Err(Problem::new(ProblemKind::OutOfRange, detail).at("/reason"));
        }
        let note = checked_note(note)?;
        Ok(Self { by, note, reason })
    }
}

/// Who decides: who has signed in, whatever they say; else as they say.
pub(super) fn decider(actor: &Actor, by: Option<String>) -> Result<String, Problem> {
    match actor.signed_in() {
        Some(name) => Ok(name.to_owned()),
        None => checked_name("/by", by),
    }
}

/// A name at a JSON pointer, as people say it; without one they are anonymous.
pub(super) fn checked_name(pointer: &str, by: Option<String>) -> Result<String, Problem> {
    let refuse = |detail: &str| Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer));
    let by = by.unwrap_or_else(|| UNNAMED.to_owned());
    let length = by.chars().count();
    if !(1..=NAME_CHARS_MAX).contains(&length) || by.chars().any(char::is_control) {
        return refuse("a name has 1 to 100 characters, none of them a control character");
    }
    if by.eq_ignore_ascii_case(SYSTEM) {
        return refuse("\"system\" is the service itself: give another name");
    }
    Ok(by)
}

/// A decision must name the decision revision that its maker has seen.
fn wanted(headers: &HeaderMap) -> Result<&str, Problem> {
    let wanted = headers.get(header::IF_MATCH).ok_or_else(|| {
        let detail = "send If-Match with the alert's ETag (its decision_revision in quotes), so that \
                      nobody decides about something else than was looked at";
        Problem::new(ProblemKind::PreconditionRequired, detail).at("If-Match")
    })?;
    Ok(wanted.to_str().unwrap_or_default())
}

/// The problem of a decision that was not taken.
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

async fn decide(
    state: &ApiState,
    id: AlertId,
    action: AlertAction,
    actor: Actor,
    headers: &HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let decision: AlertDecision = small_json(state, headers, body).await?;
    let by = decider(&actor, decision.by)?;
    let why = Why::checked(action, by, decision.note, decision.reason)?;
    known_alert(state, id).await?;
    carry_out(state, id, action, actor, wanted(headers)?, why).await?;
    Ok(with_etag(known_alert(state, id).await?))
}

/// Carries a decision out if the alert is as one of the wanted ETags says.
async fn carry_out(
    state: &ApiState,
    id: AlertId,
    action: AlertAction,
    actor: Actor,
    wanted: &str,
    why: Why,
) -> Result<(), Problem> {
    let alert = known_alert(state, id).await?;
    if !is_among(wanted, &etag(&alert)) {
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
    decided.map(|_| ()).map_err(|error| refused(error, action))
}

/// Take an alert up.
///
/// Tells others that somebody looks at it. The map stays as it is.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/acknowledge", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn acknowledge_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    decide(&state, id, AlertAction::Acknowledge, actor, &headers, body).await
}

/// Take a change into the map.
///
/// Retires the closures that contradict it, solves their sub-graph again, and begins the next
/// version of the map. Answers when the new map stands.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/accept", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn accept_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    decide(&state, id, AlertAction::Accept, actor, &headers, body).await
}

/// Keep the map as it is.
///
/// The same thing at the same place is not raised again.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/dismiss", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn dismiss_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    decide(&state, id, AlertAction::Dismiss, actor, &headers, body).await
}

/// Put an alert back among the open ones.
///
/// For what was acknowledged, dismissed or resolved too early.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/reopen", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn reopen_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    decide(&state, id, AlertAction::Reopen, actor, &headers, body).await
}

/// Take an acceptance back.
///
/// The map shows the old state again, as its next version; the alert is what it was before.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/undo", tag = "alerts",
    params(AlertParam, IfAlertMatches),
    request_body(content = AlertDecision, description = "Who decides, and why"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new decision revision, in quotes"))), DecisionProblems)
)]
pub(in crate::api) async fn undo_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    decide(&state, id, AlertAction::Undo, actor, &headers, body).await
}
