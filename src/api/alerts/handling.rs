//! Who sees to an alert, and what people write about it.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::decisions::checked_name;
use super::{AlertBody, known_alert, unknown_alert, with_etag};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use crate::api::note::checked_note;
use crate::api::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use crate::api::parameters::AlertParam;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::{AlertProblems, HandlingProblems};
use crate::api::upload::small_json;
use crate::ids::AlertId;
use crate::model::Actor;
use crate::store::CommentRecord;

/// Who sees to an alert.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"assignee": "kim"}))]
pub(in crate::api) struct AlertAssignee {
    /// A name of 1 to 100 characters; null if nobody does.
    #[serde(deserialize_with = "Option::deserialize")]
    #[schema(
        required,
        min_length = 1,
        max_length = 100,
        pattern = r"^[^\x00-\x1f\x7f-\x9f]*$"
    )]
    assignee: Option<String>,
}

/// A comment to be added.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"text": "the forklift driver knows about it", "by": "kim"}))]
pub(in crate::api) struct CommentPost {
    /// What, 1 to 2,000 characters.
    #[schema(
        min_length = 1,
        max_length = 2000,
        pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$"
    )]
    text: String,
    /// Who writes it; `anonymous` if left out.
    #[schema(
        min_length = 1,
        max_length = 100,
        pattern = r"^[^\x00-\x1f\x7f-\x9f]*$"
    )]
    by: Option<String>,
}

/// A comment on an alert.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertComment)]
pub(in crate::api) struct CommentBody {
    /// 1, 2, … over all alerts, in the order in which comments were written.
    id: i64,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// Who.
    by: String,
    /// What.
    text: String,
}

/// A part of the comments on an alert.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AlertCommentPage)]
pub(in crate::api) struct CommentPage {
    /// The oldest first.
    items: Vec<CommentBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for CommentPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

impl From<CommentRecord> for CommentBody {
    fn from(comment: CommentRecord) -> Self {
        Self {
            id: comment.key,
            at: comment.at,
            by: comment.by,
            text: comment.text,
        }
    }
}

/// Assign an alert.
///
/// Says who sees to it. Raises the alert's `revision`, so that streams carry it, and refuses nobody's
/// decision.
#[utoipa::path(
    put, path = "/v1/alerts/{alert}/assignee", tag = "alerts", params(AlertParam),
    request_body(content = AlertAssignee, description = "Who"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's decision revision, in quotes"))), HandlingProblems)
)]
pub(in crate::api) async fn assign_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let AlertAssignee { assignee } = small_json(&state, &headers, body).await?;
    let assignee = assignee.map(|name| checked_name("/assignee", Some(name)));
    let assignee = assignee.transpose()?;
    let assigned = state
        .store
        .assign_alert(id, assignee, &actor, Timestamp::now());
    if !assigned.await? {
        return Err(unknown_alert());
    }
    Ok(with_etag(known_alert(&state, id).await?))
}

/// Comment on an alert.
///
/// Raises the alert's `revision`, so that streams carry it, and refuses nobody's decision.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/comments", tag = "alerts", params(AlertParam),
    request_body(content = CommentPost, description = "What"),
    responses((status = 201, description = "The comment", body = CommentBody), HandlingProblems)
)]
pub(in crate::api) async fn comment_on_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<(StatusCode, Json<CommentBody>), Problem> {
    let post: CommentPost = small_json(&state, &headers, body).await?;
    let by = checked_name("/by", post.by)?;
    let refuse = |detail: String| Problem::new(ProblemKind::OutOfRange, detail).at("/text");
    let text =
        checked_note(Some(post.text)).map_err(|problem| refuse(problem.detail().to_owned()))?;
    let text = text.ok_or_else(|| refuse("write something".to_owned()))?;
    let now = Timestamp::now();
    let comment = state.store.comment_on_alert(id, by, text, &actor, now);
    let comment = comment.await?.ok_or_else(unknown_alert)?;
    Ok((StatusCode::CREATED, Json(comment.into())))
}

/// List the comments on an alert.
///
/// The oldest first, in parts.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}/comments", tag = "alerts", params(AlertParam, PageQuery),
    responses((status = 200, description = "A part of the list", body = CommentPage), AlertProblems)
)]
pub(in crate::api) async fn list_alert_comments(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<CommentPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    known_alert(&state, id).await?;
    let after = after.unwrap_or(0);
    let mut comments = state.store.alert_comments(id, after, limit + 1).await?;
    let next_cursor = cut_page(&mut comments, limit, |comment| comment.key.to_string());
    Ok(Listed(CommentPage {
        items: comments.into_iter().map(CommentBody::from).collect(),
        next_cursor,
    }))
}
