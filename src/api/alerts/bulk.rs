//! Decisions about several alerts in one request.

use std::collections::BTreeSet;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::decisions::{Why, carry_out, decider};
use super::{AlertBody, unknown_alert};
use crate::api::ApiState;
use crate::api::access::Identity;
use crate::api::extract::NoQuery;
use crate::api::problem::{Problem, ProblemBody, ProblemKind};
use crate::api::problem_responses::DecisionsProblems;
use crate::api::upload::small_json;
use crate::change::AlertAction;
use crate::ids::AlertId;
use crate::model::{Actor, DismissReason};
use crate::store::AlertRecord;

const DECISIONS_MAX: usize = 200;
/// Each begins a version of a map and takes up to seconds.
const MAP_CHANGES_MAX: usize = 10;

/// Decisions about several alerts.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"decisions": [{"id": "019aa000-0000-7000-8000-000000000001", "action": "dismiss", "if_match": "\"3\"", "reason": "people"}], "by": "J. Kovács"}))]
pub(in crate::api) struct DecisionsPost {
    /// Carried out in this order, each on its own; no alert twice, and at most 10 of them `accept` or
    /// `undo`.
    #[schema(min_items = 1, max_items = 200)]
    decisions: Vec<DecisionPost>,
    /// Who decided, if no key says it; `anonymous` if left out. Ignored of those who have signed in.
    #[schema(min_length = 1, max_length = 100, nullable = false)]
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
    #[schema(max_length = 2000, nullable = false)]
    note: Option<String>,
    /// Why it is dismissed; with `dismiss` alone.
    #[schema(nullable = false)]
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
    fn tag(&self) -> String {
        match self {
            Self::Revision(revision) => format!("\"{revision}\""),
            Self::Tag(tag) => tag.clone(),
        }
    }
}

/// What became of several decisions.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api) struct DecisionsAnswer {
    /// In the order of the request.
    items: Vec<DecisionAnswer>,
}

/// What became of a decision.
#[derive(Debug, Serialize, ToSchema)]
struct DecisionAnswer {
    /// The alert.
    #[schema(format = "uuid")]
    id: String,
    /// Whether it was carried out.
    result: DecisionResult,
    /// The alert as it is now; null if there is none, or if it could not be read.
    #[schema(required)]
    alert: Option<AlertBody>,
    /// Why it was not carried out; null if it was, or had been before.
    #[schema(required)]
    problem: Option<ProblemBody>,
}

/// Whether a decision was carried out: `done`; `already_done`, the alert has that status; `changed`, it is
/// not as `if_match` says; `not_allowed` for its status or kind; `unknown`, there is no such alert;
/// `failed`, the same may succeed later.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum DecisionResult {
    Done,
    AlreadyDone,
    Changed,
    NotAllowed,
    Unknown,
    Failed,
}

impl DecisionResult {
    fn of(kind: ProblemKind) -> Self {
        match kind {
            ProblemKind::PreconditionFailed => Self::Changed,
            ProblemKind::TransitionNotAllowed => Self::NotAllowed,
            ProblemKind::NotFound => Self::Unknown,
            _ => Self::Failed,
        }
    }
}

impl DecisionsPost {
    /// All of it, before anything is carried out.
    fn check(self, actor: &Actor) -> Result<Vec<(DecisionPost, Why)>, Problem> {
        let refuse =
            |detail: &str| Err(Problem::new(ProblemKind::OutOfRange, detail).at("/decisions"));
        if !(1..=DECISIONS_MAX).contains(&self.decisions.len()) {
            return refuse("send 1 to 200 decisions at a time");
        }
        let ids: BTreeSet<AlertId> = self.decisions.iter().map(|one| one.id).collect();
        if ids.len() < self.decisions.len() {
            return refuse("an alert is decided about once in a request");
        }
        let changes_map =
            |one: &&DecisionPost| matches!(one.action, AlertAction::Accept | AlertAction::Undo);
        if self.decisions.iter().filter(changes_map).count() > MAP_CHANGES_MAX {
            return refuse(
                "accept and undo make a new map each: send at most 10 of them at a time",
            );
        }
        let by = decider(actor, self.by)?;
        let decisions = self.decisions.into_iter().enumerate();
        let checked = decisions.map(|(k, mut one)| {
            let why = Why::checked(one.action, by.clone(), one.note.take(), one.reason);
            let why = why.map_err(|problem| problem.below(&format!("/decisions/{k}")))?;
            Ok((one, why))
        });
        checked.collect()
    }
}

/// Decide about several alerts.
///
/// Each decision is carried out or not on its own. One that has been made before is answered
/// `already_done`, so that the same request can be sent again.
#[utoipa::path(
    post, path = "/v1/alerts/decisions", tag = "alerts",
    request_body(content = DecisionsPost, description = "The decisions"),
    responses((status = 200, description = "What became of each", body = DecisionsAnswer), DecisionsProblems)
)]
pub(in crate::api) async fn decide_alerts(
    State(state): State<ApiState>,
    _: NoQuery,
    identity: Identity,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<DecisionsAnswer>, Problem> {
    let post: DecisionsPost = small_json(&state, &headers, body).await?;
    let mut items = Vec::new();
    for (one, why) in post.check(&actor)? {
        items.push(answer(&state, &identity, &one, why, actor.clone()).await?);
    }
    Ok(Json(DecisionsAnswer { items }))
}

async fn answer(
    state: &ApiState,
    identity: &Identity,
    one: &DecisionPost,
    why: Why,
    actor: Actor,
) -> Result<DecisionAnswer, Problem> {
    let before = state.store.alert(one.id).await?;
    let is_hidden = |alert: &AlertRecord| !identity.sees(&alert.route_id);
    if before.as_ref().is_some_and(is_hidden) {
        return Ok(DecisionAnswer {
            id: one.id.to_string(),
            result: DecisionResult::Unknown,
            alert: None,
            problem: Some(unknown_alert().body("")),
        });
    }
    let is_made = |status| one.action.leads_to() == Some(status);
    let (result, problem) = match before {
        Some(alert) if is_made(alert.status) => (DecisionResult::AlreadyDone, None),
        _ => match carry_out(state, one.id, one.action, actor, &one.if_match.tag(), why).await {
            Ok(()) => (DecisionResult::Done, None),
            Err(problem) => (DecisionResult::of(problem.kind()), Some(problem.body(""))),
        },
    };
    let alert = state.store.alert(one.id).await?;
    Ok(DecisionAnswer {
        id: one.id.to_string(),
        result,
        alert: alert.map(AlertBody::from),
        problem,
    })
}
