//! Decisions about several alerts in one request.

use std::collections::BTreeSet;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::AlertBody;
use super::decisions::{Why, decider};
use crate::api::ApiState;
use crate::api::access::Identity;
use crate::api::extract::NoQuery;
use crate::api::operation::{OperationBody, taken_on};
use crate::api::problem::{Problem, ProblemBody, ProblemKind};
use crate::api::problem_responses::DecisionsProblems;
use crate::api::upload::small_json;
use crate::change::AlertAction;
use crate::ids::{AlertId, RouteId};
use crate::model::{Actor, DecisionResult, DismissReason};
use crate::store::{
    AlertRecord, DecisionOutcome, DecisionRequest, DecisionsRequest, OperationRequest,
};

const DECISIONS_MAX: usize = 200;
/// Each begins a version of a map and takes up to seconds.
const UNDOS_MAX: usize = 10;

/// Decisions about several alerts.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"decisions": [{"id": "019aa000-0000-7000-8000-000000000001", "action": "dismiss", "if_match": "\"3\"", "reason": "people"}], "by": "J. Kovács"}))]
pub(in crate::api) struct DecisionsPost {
    /// First those that accept nothing are carried out, in this order, each on its own; then what is
    /// accepted, which makes one version of the map of each route. No alert twice, and at most 10 of them
    /// `undo`.
    #[schema(min_items = 1, max_items = 200)]
    decisions: Vec<DecisionPost>,
    /// Who decided, if no key says it; `anonymous` if left out. Ignored of those who have signed in.
    #[schema(
        min_length = 1,
        max_length = 100,
        pattern = r"^[^\x00-\x1f\x7f-\x9f]*$"
    )]
    by: Option<String>,
}

/// One of several decisions.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = DecisionPost)]
struct DecisionPost {
    /// The alert.
    #[schema(value_type = String, format = "uuid")]
    id: AlertId,
    /// What to do.
    action: AlertAction,
    /// The alert's ETag as it was read: its `decision_revision` in quotes. A number is taken for it.
    #[schema(value_type = String)]
    if_match: IfMatch,
    /// Why, for people.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
    /// Why it is dismissed; with `dismiss` alone.
    reason: Option<DismissReason>,
}

/// What an alert's ETag is compared with.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum IfMatch {
    Revision(i64),
    Tag(String),
}

impl IfMatch {
    /// The decision revisions that it names; `None` for `*`, which matches all.
    fn decision_revisions(&self) -> Option<Vec<i64>> {
        let tags = match self {
            Self::Revision(revision) => return Some(vec![*revision]),
            Self::Tag(tags) => tags.split(',').map(str::trim),
        };
        if tags.clone().any(|tag| tag == "*") {
            return None;
        }
        let quoted = |tag: &str| tag.strip_prefix('"')?.strip_suffix('"')?.parse().ok();
        Some(tags.filter_map(quoted).collect())
    }
}

/// What became of several decisions.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api) struct DecisionsAnswer {
    /// In the order of the request.
    items: Vec<DecisionAnswer>,
}

/// What became of a decision, and the alert.
#[derive(Debug, Serialize, ToSchema)]
struct DecisionAnswer {
    /// The alert.
    #[schema(format = "uuid")]
    id: String,
    /// What was to be done.
    action: AlertAction,
    /// Whether it was.
    result: DecisionResult,
    /// The version of the map that began with an `accept`; null if none did.
    #[schema(required)]
    map_version: Option<i64>,
    /// The alert as it is now; null if there is none.
    #[schema(required)]
    alert: Option<AlertBody>,
    /// Why it was not carried out; null if it was, or had been before.
    #[schema(required)]
    problem: Option<ProblemBody>,
}

impl DecisionAnswer {
    fn new(outcome: DecisionOutcome, alert: Option<AlertRecord>) -> Self {
        let DecisionOutcomeBody {
            id,
            action,
            result,
            map_version,
            problem,
        } = outcome.into();
        Self {
            id,
            action,
            result,
            map_version,
            alert: alert.map(AlertBody::from),
            problem,
        }
    }
}

/// What became of a decision.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DecisionOutcome)]
pub(in crate::api) struct DecisionOutcomeBody {
    /// The alert.
    #[schema(format = "uuid")]
    id: String,
    /// What was to be done.
    action: AlertAction,
    /// Whether it was.
    result: DecisionResult,
    /// The version of the map that began with an `accept`; null if none did.
    #[schema(required)]
    map_version: Option<i64>,
    /// Why it was not carried out; null if it was, or had been before.
    #[schema(required)]
    problem: Option<ProblemBody>,
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

impl DecisionsPost {
    /// All of it, before anything is carried out.
    fn check(self, identity: &Identity, actor: Actor) -> Result<DecisionsRequest, Problem> {
        let refuse =
            |detail: &str| Err(Problem::new(ProblemKind::OutOfRange, detail).at("/decisions"));
        if !(1..=DECISIONS_MAX).contains(&self.decisions.len()) {
            return refuse("send 1 to 200 decisions at a time");
        }
        let ids: BTreeSet<AlertId> = self.decisions.iter().map(|one| one.id).collect();
        if ids.len() < self.decisions.len() {
            return refuse("an alert is decided about once in a request");
        }
        if count(&self.decisions, AlertAction::Undo) > UNDOS_MAX {
            return refuse("each undo makes a new map: send at most 10 of them at a time");
        }
        let by = decider(&actor, self.by)?;
        let decisions = self.decisions.into_iter().enumerate();
        let checked = decisions.map(|(k, one)| {
            let why = Why::checked(one.action, by.clone(), one.note, one.reason);
            let why = why.map_err(|problem| problem.below(&format!("/decisions/{k}")))?;
            Ok(DecisionRequest {
                alert_id: one.id,
                action: one.action,
                decision_revisions: one.if_match.decision_revisions(),
                note: why.note,
                reason: why.reason,
            })
        });
        Ok(DecisionsRequest {
            decisions: checked.collect::<Result<_, Problem>>()?,
            by,
            actor,
            routes: identity.routes.clone(),
        })
    }
}

fn count(decisions: &[DecisionPost], action: AlertAction) -> usize {
    decisions.iter().filter(|one| one.action == action).count()
}

/// Decide about several alerts.
///
/// Each decision is carried out or not on its own; what is accepted on one route makes one version of its
/// map. A decision that has been made before is answered `already_done`, so that the same request can be
/// sent again. With more than one `accept` the answer is 202 and names an operation, whose result says what
/// became of each; it goes on if the service is restarted meanwhile.
#[utoipa::path(
    post, path = "/v1/alerts/decisions", tag = "alerts",
    request_body(content = DecisionsPost, description = "The decisions"),
    responses(
        (status = 200, description = "What became of each", body = DecisionsAnswer),
        (status = 202, description = "They will be carried out", body = OperationBody, headers(("Location" = String, description = "The operation"))),
        DecisionsProblems,
    )
)]
pub(in crate::api) async fn decide_alerts(
    State(state): State<ApiState>,
    _: NoQuery,
    identity: Identity,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let post: DecisionsPost = small_json(&state, &headers, body).await?;
    let is_long = count(&post.decisions, AlertAction::Accept) > 1;
    let request = post.check(&identity, actor.clone())?;
    if is_long {
        let route = the_route(&state, &request).await?;
        let request = OperationRequest::Decisions(request);
        let id = state.operations.ask_for(route.as_ref(), request, &actor);
        return taken_on(&state, id.await?).await;
    }
    let mut items = Vec::new();
    for outcome in state.decisions.decide_all(request).await? {
        let alert = state.store.alert(outcome.alert_id).await?;
        let alert = alert.filter(|alert| identity.sees(&alert.route_id));
        items.push(DecisionAnswer::new(outcome, alert));
    }
    Ok(Json(DecisionsAnswer { items }).into_response())
}

/// The route of the alerts that are decided about, if it is one.
async fn the_route(
    state: &ApiState,
    request: &DecisionsRequest,
) -> Result<Option<RouteId>, Problem> {
    let mut routes = BTreeSet::new();
    for decision in &request.decisions {
        let alert = state.store.alert(decision.alert_id).await?;
        let alert = alert.filter(|alert| request.covers(&alert.route_id));
        routes.extend(alert.map(|alert| alert.route_id));
    }
    Ok(routes.pop_first().filter(|_| routes.is_empty()))
}
