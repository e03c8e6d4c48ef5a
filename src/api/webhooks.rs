//! Webhooks: who is sent events by a POST.

mod body;
mod calls;
mod change;
mod deliveries;
mod forms;
mod registration;
mod rotation;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ApiState;
use super::access::Identity;
use super::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use super::if_match::if_match;
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::parameters::WebhookParam;
use super::problem::{Problem, ProblemKind};
use super::problem_responses::{AnyProblems, WebhookDeletionProblems, WebhookProblems};
use crate::ids::WebhookId;
use crate::model::Actor;
use crate::store::{Edited, WebhookRecord};
use crate::webhooks::UrlRefusal;

use body::{WebhookBody, etag};
pub(super) use calls::add_calls;
pub(super) use change::*;
pub(super) use deliveries::*;
pub use forms::EventForms;
pub(super) use registration::*;
pub(super) use rotation::*;

/// A part of the list of webhooks.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct WebhookPage {
    /// The oldest first.
    items: Vec<WebhookBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for WebhookPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// List webhooks.
///
/// All of them, the oldest first, in parts; of a key that is limited to routes, those of these alone.
#[utoipa::path(
    get, path = "/v1/webhooks", tag = "webhooks", params(PageQuery),
    responses((status = 200, description = "A part of the list", body = WebhookPage), AnyProblems)
)]
pub(super) async fn list_webhooks(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<WebhookPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let after: Option<WebhookId> = key_of_cursor(query.cursor.as_deref())?;
    let mut webhooks = match &identity.routes {
        None => state.store.webhooks(after, limit + 1).await?,
        Some(own) => state.store.webhooks_among(own, after, limit + 1).await?,
    };
    let next_cursor = cut_page(&mut webhooks, limit, |webhook| webhook.id.to_string());
    Ok(Listed(WebhookPage {
        items: webhooks.into_iter().map(WebhookBody::from).collect(),
        next_cursor,
    }))
}

/// Read a webhook.
///
/// Where it leads, which events it is sent, and whether it is active.
#[utoipa::path(
    get, path = "/v1/webhooks/{webhook}", tag = "webhooks",
    params(WebhookParam),
    responses((status = 200, description = "The webhook", body = WebhookBody, headers(("ETag" = String, description = "Changes with every edit"))), WebhookProblems)
)]
pub(super) async fn get_webhook(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    _: NoQuery,
) -> Result<Response, Problem> {
    Ok(with_etag(known_webhook(&state, id).await?))
}

/// Delete a webhook.
///
/// Deletes it with what is known of its deliveries. What is being sent at this moment may still
/// arrive; nothing else is sent any more.
#[utoipa::path(
    delete, path = "/v1/webhooks/{webhook}", tag = "webhooks",
    params(
        WebhookParam,
        ("If-Match" = Option<String>, Header, nullable = false, description = "Refuse the deletion unless the webhook has this ETag"),
    ),
    responses((status = 204, description = "Deleted"), WebhookDeletionProblems)
)]
pub(super) async fn delete_webhook(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    let revision = wanted_revision(&headers, &known_webhook(&state, id).await?)?;
    let now = Timestamp::now();
    check_edited(state.store.delete_webhook(id, revision, &by, now).await?)?;
    Ok(StatusCode::NO_CONTENT)
}

pub(super) async fn known_webhook(
    state: &ApiState,
    id: WebhookId,
) -> Result<WebhookRecord, Problem> {
    state.store.webhook(id).await?.ok_or_else(unknown_webhook)
}

pub(super) fn unknown_webhook() -> Problem {
    let detail = "there is no such webhook: GET /v1/webhooks lists them";
    Problem::new(ProblemKind::NotFound, detail)
}

/// The revision that an edit is bound to by `If-Match`, if it is.
fn wanted_revision(headers: &HeaderMap, webhook: &WebhookRecord) -> Result<Option<i64>, Problem> {
    match if_match(headers, &etag(webhook)) {
        None => Ok(None),
        Some(true) => Ok(Some(webhook.revision)),
        Some(false) => Err(stale()),
    }
}

fn check_edited(edited: Edited) -> Result<(), Problem> {
    match edited {
        Edited::Done => Ok(()),
        Edited::Stale => Err(stale()),
        Edited::Unknown => Err(unknown_webhook()),
    }
}

fn stale() -> Problem {
    let detail = "the webhook is not as If-Match says: read it again";
    Problem::new(ProblemKind::PreconditionFailed, detail).at("If-Match")
}

fn url_refused(refusal: UrlRefusal) -> Problem {
    Problem::new(ProblemKind::WebhookUrlRefused, refusal.to_string()).at("/url")
}

fn with_etag(webhook: WebhookRecord) -> Response {
    let headers = [(header::ETAG, etag(&webhook))];
    (headers, Json(WebhookBody::from(webhook))).into_response()
}

/// A webhook with its secret, which no other answer has: it must not be stored on the way.
fn with_secret(webhook: WebhookRecord, secret: String) -> Response {
    let headers = [
        (header::ETAG, etag(&webhook)),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ];
    let mut body = WebhookBody::from(webhook);
    body.secret = Some(secret);
    (headers, Json(body)).into_response()
}
