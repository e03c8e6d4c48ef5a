//! Decisions about several alerts in one request.

use std::collections::BTreeSet;

use axum::Json;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::body::AlertBody;
use super::outcome::DecisionOutcomeBody;
use super::reason::{Why, decider};
use crate::api::ApiState;
use crate::api::access::Identity;
use crate::api::extract::NoQuery;
use crate::api::operation::{OperationBody, accepted};
use crate::api::problem::{Problem, ProblemBody, ProblemKind};
use crate::api::problem_responses::DecisionsProblems;
use crate::api::upload::SmallJson;
use crate::ids::{AlertId, RouteId};
use crate::model::{Actor, AlertAction, DecisionResult, DismissReason};
use crate::store::{
    AlertRecord, DecisionOutcome, DecisionRequest, DecisionsRequest, OperationRequest,
};

const DECISIONS_MAX: usize = 200;
/// Each begins a version of a map, which can take seconds.
const UNDOS_MAX: usize = 10;

/// Decisions about several alerts.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"decisions": [{"id": "019aa000-0000-7000-8000-000000000001", "action": "dismiss", "if_match": "\"3\"", "reason": "people"}], "by": "J. Kovács"}))]
pub(in crate::api) struct DecisionsPost {
    /// Decisions other than `accept` are carried out first, one by one in this order; then everything that is
    /// accepted, which makes one version of each route's map. No alert may occur twice, and at most 10
    /// decisions may be `undo`.
    #[schema(min_items = 1, max_items = 200)]
    decisions: Vec<DecisionPost>,
    /// Who decided, if no key identifies them; `anonymous` by default. Ignored for people who have signed in.
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
    /// The alert's ETag as it was read: its `decision_revision` in quotes, or as a number.
    #[schema(value_type = String)]
    if_match: IfMatch,
    /// Why, for people.
    #[schema(max_length = 2000, pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$")]
    note: Option<String>,
    /// Why it is dismissed; only with `dismiss`.
    reason: Option<DismissReason>,
}

/// The ETags or the revision that an alert's ETag is compared with.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum IfMatch {
    Revision(i64),
    Tag(String),
}

impl IfMatch {
    /// The decision revisions that are named; `None` for `*`, which matches all.
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

/// The outcomes of several decisions.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api) struct DecisionsAnswer {
    /// In the order of the request.
    items: Vec<DecisionAnswer>,
}

/// The outcome of a decision, and the alert.
#[derive(Debug, Serialize, ToSchema)]
struct DecisionAnswer {
    /// The alert.
    #[schema(format = "uuid")]
    id: String,
    /// The requested action.
    action: AlertAction,
    /// Whether it was carried out.
    result: DecisionResult,
    /// The version of the map that an `accept` began; null if none did.
    #[schema(required)]
    map_version: Option<i64>,
    /// The alert as it is now; null if there is none.
    #[schema(required)]
    alert: Option<AlertBody>,
    /// Why it was not carried out; null if it was, now or before.
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

impl DecisionsPost {
    /// Checks all decisions before any is carried out.
    fn check(self, identity: &Identity, actor: Actor) -> Result<DecisionsRequest, Problem> {
        let refuse =
            |detail: &str| Err(Problem::new(ProblemKind::OutOfRange, detail).at("/decisions"));
        if !(1..=DECISIONS_MAX).contains(&self.decisions.len()) {
            return refuse("send 1 to 200 decisions at a time");
        }
        let ids: BTreeSet<AlertId> = self.decisions.iter().map(|one| one.id).collect();
        if ids.len() < self.decisions.len() {
            return refuse("decide about an alert only once in a request");
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
/// Each decision succeeds or fails on its own; everything accepted on one route makes one version of its map.
/// A decision that was made before has the result `already_done`, so the same request can be repeated. With
/// more than one `accept` the answer is 202 and names an operation, whose result has the outcome of each
/// decision; it continues after a restart of the service.
#[utoipa::path(
    post, path = "/v1/alerts/decisions", tag = "alerts",
    request_body(content = DecisionsPost, description = "The decisions"),
    responses(
        (status = 200, description = "The outcome of each", body = DecisionsAnswer),
        (status = 202, description = "They will be carried out", body = OperationBody, headers(("Location" = String, description = "The operation"))),
        DecisionsProblems,
    )
)]
pub(in crate::api) async fn decide_alerts(
    State(state): State<ApiState>,
    _: NoQuery,
    identity: Identity,
    actor: Actor,
    SmallJson(post): SmallJson<DecisionsPost>,
) -> Result<Response, Problem> {
    let is_long = count(&post.decisions, AlertAction::Accept) > 1;
    let request = post.check(&identity, actor.clone())?;
    if is_long {
        let route = the_route(&state, &request).await?;
        let request = OperationRequest::Decisions(request);
        let id = state.operations.ask_for(route.as_ref(), request, &actor);
        return accepted(&state, id.await?).await;
    }
    let mut items = Vec::new();
    for outcome in state.decisions.decide_all(request).await? {
        let alert = state.store.alert(outcome.alert_id).await?;
        let alert = alert.filter(|alert| identity.sees(&alert.route_id));
        items.push(DecisionAnswer::new(outcome, alert));
    }
    Ok(Json(DecisionsAnswer { items }).into_response())
}

/// The route of the alerts, if all are of one.
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
