//! What people decide about alerts.

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::Response;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::body::{allowed_actions, etag};
use super::{AlertBody, known_alert, unknown_alert, with_etag};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::if_match::is_among;
use crate::api::note::checked_note;
use crate::api::parameters::{AlertParam, IfAlertMatches};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::DecisionProblems;
use crate::api::upload::small_json;
use crate::change::{AlertAction, ChangeKind};
use crate::ids::AlertId;
use crate::model::{Actor, DismissReason};
use crate::pipeline::{DecisionError, Order};
use crate::store::{AlertRecord, SYSTEM};

const NAME_CHARS_MAX: usize = 100;
/// Who decided, where nobody says so.
const UNNAMED: &str = "anonymous";

/// What goes with a decision; an empty body is as good as `{}`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"note": "new rack, as planned", "by": "J. Kovács"}))]
pub(in crate::api) struct AlertDecision {
    /// Why, for people.
    #[schema(max_length = 2000)]
    note: Option<String>,
    /// Why it is dismissed; with `dismiss` alone.
    #[schema(nullable = false)]
    reason: Option<DismissReason>,
    /// Who decided, if no key says it; `anonymous` if left out. Ignored of those who have signed in: their
    /// own name stands in the history.
    #[schema(min_length = 1, max_length = 100)]
    by: Option<String>,
}

/// Who decides, and why.
pub(super) struct Why {
    by: String,
    note: Option<String>,
    reason: Option<DismissReason>,
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
        None => checked_name(by),
    }
}

fn checked_name(by: Option<String>) -> Result<String, Problem> {
    let refuse = |detail: &str| Err(Problem::new(ProblemKind::OutOfRange, detail).at("/by"));
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

/// What a decision is about has changed since; more evidence alone never comes here.
fn stale(alert: &AlertRecord) -> Problem {
    let last = alert.history.last().map(|last| (&last.by, last.at));
    let since = last.map_or_else(String::new, |(by, at)| format!(" since {at:.0} by {by}"));
    let detail = format!(
        "the alert is not as If-Match says: it is {} ({}){since}, its decision_revision is {}; look \
         at its status, tier and region, and decide again",
        alert.status.name(),
        alert.evidence.tier.name(),
        alert.decision_revision,
    );
    Problem::new(ProblemKind::PreconditionFailed, detail).at("If-Match")
}

/// The problem of an action that the alert's status does not allow, or that takes into the map what
/// is no change of the world.
fn refused(alert: &AlertRecord, action: AlertAction) -> Problem {
    let allowed = allowed_actions(alert).into_iter().map(AlertAction::name);
    let allowed: Vec<&str> = allowed.collect();
    let possible = match allowed.as_slice() {
        [] => "nothing can be done with it".to_owned(),
        names => format!("what is possible now: {}", names.join(", ")),
    };
    let reason = match alert.status.allows(action) {
        true if alert.evidence.kind == ChangeKind::MapMismatch => {
            "of kind map_mismatch: the map is wrong there, not the world, and there is nothing to \
             take into it; it is mended, and the alert resolved, once scans prove where the segment \
             belongs"
                .to_owned()
        }
        true => format!(
            "of kind {}: no change of the world",
            alert.evidence.kind.name()
        ),
        false => format!("that is {}", alert.status.name()),
    };
    let detail = format!(
        "{} is not possible with an alert {reason}; {possible}",
        action.name()
    );
    Problem::new(ProblemKind::TransitionNotAllowed, detail)
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
pub(super) async fn carry_out(
    state: &ApiState,
    id: AlertId,
    action: AlertAction,
    actor: Actor,
    wanted: &str,
    why: Why,
) -> Result<(), Problem> {
    let alert = known_alert(state, id).await?;
    if !is_among(wanted, &etag(&alert)) {
        return Err(stale(&alert));
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
    match state.decisions.decide(order).await {
        Ok(_) => Ok(()),
        Err(DecisionError::UnknownAlert) => Err(unknown_alert()),
        Err(DecisionError::Changed(alert)) => Err(stale(&alert)),
        Err(DecisionError::NotAllowed(alert)) => Err(refused(&alert, action)),
        Err(DecisionError::Busy) => {
            let detail = "the route changes too quickly; send the same again later";
            Err(Problem::new(ProblemKind::Overloaded, detail))
        }
        Err(DecisionError::Store(error)) => Err(error.into()),
        Err(error @ DecisionError::Failed(_)) => Err(Problem::internal(error)),
    }
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
