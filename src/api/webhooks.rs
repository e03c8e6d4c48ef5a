//! Webhooks: receivers to which events are POSTed.

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

use super::ApiState;
use super::access::Identity;
use super::extract::{ApiPath, ApiQuery, NoQuery};
use super::if_match::{bound_revision, stale};
use super::paging::{Listed, PageQuery, page};
use super::parameters::{IfMatch, WebhookParam};
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

page! {
    /// A page of the list of webhooks.
    pub(super) struct WebhookPage {
        /// The oldest first.
        items: Vec<WebhookBody>,
    }
}

/// List webhooks.
///
/// The oldest first; for a key that is limited to routes, only webhooks of those routes.
#[utoipa::path(
    get, path = "/v1/webhooks", tag = "webhooks", params(PageQuery),
    responses((status = 200, description = "A page of the list", body = WebhookPage), AnyProblems)
)]
pub(super) async fn list_webhooks(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<WebhookPage>, Problem> {
    let wanted = query.wanted::<WebhookId>()?;
    let (store, after, limit) = (&state.store, wanted.after, wanted.to_read());
    let webhooks = match &identity.routes {
        None => store.webhooks(after, limit).await?,
        Some(own) => store.webhooks_among(own, after, limit).await?,
    };
    Ok(wanted.page(webhooks, |webhook| webhook.id, WebhookBody::from))
}

/// Read a webhook.
///
/// Its URL, its events, and whether it is active.
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
/// Deletes it with the record of its deliveries. A call that is under way may still arrive; nothing more is
/// sent.
#[utoipa::path(
    delete, path = "/v1/webhooks/{webhook}", tag = "webhooks",
    params(WebhookParam, IfMatch),
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

/// A webhook as it is now.
///
/// # Errors
/// The [`Problem`] that there is none.
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

/// The revision that `If-Match` binds an edit to; `None` without the header.
fn wanted_revision(headers: &HeaderMap, webhook: &WebhookRecord) -> Result<Option<i64>, Problem> {
    bound_revision(headers, &etag(webhook), webhook.revision, "webhook")
}

fn check_edited(edited: Edited) -> Result<(), Problem> {
    match edited {
        Edited::Done => Ok(()),
        Edited::Stale => Err(stale("webhook")),
        Edited::Unknown => Err(unknown_webhook()),
    }
}

fn url_refused(refusal: UrlRefusal) -> Problem {
    Problem::new(ProblemKind::WebhookUrlRefused, refusal.to_string()).at("/url")
}

fn with_etag(webhook: WebhookRecord) -> Response {
    let headers = [(header::ETAG, etag(&webhook))];
    (headers, Json(WebhookBody::from(webhook))).into_response()
}

/// The answer with a webhook and its secret, which caches must not keep.
fn with_secret(webhook: WebhookRecord, secret: String) -> Response {
    let headers = [
        (header::ETAG, etag(&webhook)),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ];
    let mut body = WebhookBody::from(webhook);
    body.secret = Some(secret);
    (headers, Json(body)).into_response()
}
