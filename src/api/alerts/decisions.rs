//! What people decide about alerts.

use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::body::{allowed_actions, etag};
use super::{AlertBody, known_alert, unknown_alert, with_etag};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::if_match::if_match;
use crate::api::note::checked_note;
use crate::api::parameters::{AlertParam, IfAlertMatches};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::DecisionProblems;
use crate::api::upload::small_json;
use crate::change::{AlertAction, ChangeKind};
use crate::ids::AlertId;
use crate::model::Actor;
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
    /// Who decided; `anonymous` if left out.
    #[schema(min_length = 1, max_length = 100)]
    by: Option<String>,
}

/// Who decides, and why.
struct Reason {
    by: String,
    note: Option<String>,
}

impl AlertDecision {
    fn check(self) -> Result<Reason, Problem> {
        let refuse = |pointer: &str, detail: &str| {
            Err(Problem::new(ProblemKind::OutOfRange, detail).at(pointer))
        };
        let note = checked_note(self.note)?;
        let by = self.by.unwrap_or_else(|| UNNAMED.to_owned());
        let length = by.chars().count();
        if !(1..=NAME_CHARS_MAX).contains(&length) || by.chars().any(char::is_control) {
            return refuse(
                "/by",
                "a name has 1 to 100 characters, none of them a control character",
            );
        }
        if by.eq_ignore_ascii_case(SYSTEM) {
            return refuse("/by", "\"system\" is the service itself: give another name");
        }
        Ok(Reason { by, note })
    }
}

/// A decision must name the revision that its maker has seen.
fn check_if_match(headers: &HeaderMap, alert: &AlertRecord) -> Result<(), Problem> {
    match if_match(headers, &etag(alert)) {
        Some(true) => Ok(()),
        Some(false) => Err(stale()),
        None => Err(Problem::new(
            ProblemKind::PreconditionRequired,
            "send If-Match with the alert's ETag (its revision in quotes), so that nobody decides \
             about something else than was looked at",
        )
        .at("If-Match")),
    }
}

fn stale() -> Problem {
    let detail = "the alert is not as If-Match says: read it again";
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
    let reason = decision.check()?;
    let alert = known_alert(state, id).await?;
    check_if_match(headers, &alert)?;
    let order = Order {
        alert_id: id,
        revision: alert.revision,
        action,
        actor,
        by: reason.by,
        note: reason.note,
        at: Timestamp::now(),
    };
    match state.decisions.decide(order).await {
        Ok(_) => Ok(with_etag(known_alert(state, id).await?)),
        Err(DecisionError::UnknownAlert) => Err(unknown_alert()),
        Err(DecisionError::Changed(_)) => Err(stale()),
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
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new revision"))), DecisionProblems)
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
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new revision"))), DecisionProblems)
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
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new revision"))), DecisionProblems)
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
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new revision"))), DecisionProblems)
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
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's new revision"))), DecisionProblems)
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
