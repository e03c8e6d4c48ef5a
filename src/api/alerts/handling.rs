//! Who is responsible for an alert, and what people write about it.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::body::{AlertBody, with_etag};
use super::known::{known_alert, unknown_alert};
use super::reason::checked_name;
use crate::api::ApiState;
use crate::api::extract::{ApiPath, ApiQuery, NoQuery};
use crate::api::note::checked_note;
use crate::api::paging::{Listed, PageQuery, page};
use crate::api::parameters::AlertParam;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::{AlertProblems, HandlingProblems};
use crate::api::upload::SmallJson;
use crate::ids::AlertId;
use crate::model::Actor;
use crate::store::CommentRecord;

/// Who is responsible for an alert.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"assignee": "kim"}))]
pub(in crate::api) struct AlertAssignee {
    /// A name of 1 to 100 characters; null for nobody.
    #[serde(deserialize_with = "Option::deserialize")]
    #[schema(
        required,
        min_length = 1,
        max_length = 100,
        pattern = r"^[^\x00-\x1f\x7f-\x9f]*$"
    )]
    assignee: Option<String>,
}

/// A comment to add.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"text": "the forklift driver knows about it", "by": "kim"}))]
pub(in crate::api) struct CommentPost {
    /// The comment, 1 to 2,000 characters.
    #[schema(
        min_length = 1,
        max_length = 2000,
        pattern = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f]*$"
    )]
    text: String,
    /// Who writes it; `anonymous` by default.
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
    /// 1, 2, … over the comments on all alerts, in the order in which they were written.
    id: i64,
    /// When it was written.
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// Who wrote it.
    by: String,
    /// The comment.
    text: String,
}

page! {
    /// A page of the comments on an alert.
    #[schema(as = AlertCommentPage)]
    pub(in crate::api) struct CommentPage {
        /// The oldest first.
        items: Vec<CommentBody>,
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
/// Sets who is responsible for it. Increases the alert's `revision`, so that streams send it, but not its
/// `decision_revision`: decisions under way remain valid.
#[utoipa::path(
    put, path = "/v1/alerts/{alert}/assignee", tag = "alerts", params(AlertParam),
    request_body(content = AlertAssignee, description = "Who is responsible"),
    responses((status = 200, description = "The alert as it is now", body = AlertBody, headers(("ETag" = String, description = "The alert's decision revision, in quotes"))), HandlingProblems)
)]
pub(in crate::api) async fn assign_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    SmallJson(AlertAssignee { assignee }): SmallJson<AlertAssignee>,
) -> Result<Response, Problem> {
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
/// Increases the alert's `revision`, so that streams send it, but not its `decision_revision`: decisions under
/// way remain valid.
#[utoipa::path(
    post, path = "/v1/alerts/{alert}/comments", tag = "alerts", params(AlertParam),
    request_body(content = CommentPost, description = "The comment"),
    responses((status = 201, description = "The comment", body = CommentBody), HandlingProblems)
)]
pub(in crate::api) async fn comment_on_alert(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    _: NoQuery,
    actor: Actor,
    SmallJson(post): SmallJson<CommentPost>,
) -> Result<(StatusCode, Json<CommentBody>), Problem> {
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
/// The oldest first.
#[utoipa::path(
    get, path = "/v1/alerts/{alert}/comments", tag = "alerts", params(AlertParam, PageQuery),
    responses((status = 200, description = "A page of the list", body = CommentPage), AlertProblems)
)]
pub(in crate::api) async fn list_alert_comments(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<AlertId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<CommentPage>, Problem> {
    let wanted = query.wanted::<i64>()?;
    known_alert(&state, id).await?;
    let after = wanted.after.unwrap_or(0);
    let comments = state.store.alert_comments(id, after, wanted.to_read());
    Ok(wanted.page(comments.await?, |comment| comment.key, CommentBody::from))
}
