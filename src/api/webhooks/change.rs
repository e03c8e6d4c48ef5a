//! Changing webhooks.

use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use super::body::{WebhookBody, check_description, checked_events};
use super::{check_edited, known_webhook, url_refused, wanted_revision, with_etag};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, NoQuery};
use crate::api::parameters::WebhookParam;
use crate::api::problem::Problem;
use crate::api::problem_responses::WebhookChangeProblems;
use crate::api::upload::small_json;
use crate::ids::WebhookId;
use crate::model::{Actor, WebhookTopic};
use crate::store::WebhookUpdate;

/// What to change of a webhook; what is left out stays as it is.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"active": false}))]
pub(in crate::api) struct WebhookChange {
    /// Where events are sent: an https URL of a public host, up to 2,048 bytes.
    #[schema(format = "uri", max_length = 2048)]
    url: Option<String>,
    /// Which ones.
    #[schema(min_items = 1)]
    events: Option<Vec<WebhookTopic>>,
    /// For people, up to 200 characters.
    #[schema(max_length = 200)]
    description: Option<String>,
    /// Whether alerts are sent also while they are tentative: seen in one pass so far.
    include_tentative: Option<bool>,
    /// Whether events are sent.
    active: Option<bool>,
}

impl WebhookChange {
    fn check(self, state: &ApiState) -> Result<WebhookUpdate, Problem> {
        let check_url = |url: String| state.receivers.check_url(&url).map_err(url_refused);
        check_description(self.description.as_deref())?;
        Ok(WebhookUpdate {
            url: self.url.map(check_url).transpose()?,
            events: self.events.map(checked_events).transpose()?,
            description: self.description,
            include_tentative: self.include_tentative,
            active: self.active,
        })
    }
}

/// Change a webhook.
///
/// What is left out stays as it is; the secret and the route always do. While a webhook is not
/// active nothing is sent: what waits for another attempt goes on waiting, and what happens
/// meanwhile is not sent later.
#[utoipa::path(
    patch, path = "/v1/webhooks/{webhook}", tag = "webhooks",
    params(
        WebhookParam,
        ("If-Match" = Option<String>, Header, nullable = false, description = "Refuse the change unless the webhook has this ETag"),
    ),
    request_body(content = WebhookChange, description = "What to change"),
    responses((status = 200, description = "The webhook as it is now", body = WebhookBody, headers(("ETag" = String, description = "Changes with every edit"))), WebhookChangeProblems)
)]
pub(in crate::api) async fn change_webhook(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let change: WebhookChange = small_json(&state, &headers, body).await?;
    let revision = wanted_revision(&headers, &known_webhook(&state, id).await?)?;
    let update = change.check(&state)?;
    let now = Timestamp::now();
    check_edited(
        state
            .store
            .update_webhook(id, revision, update, &by, now)
            .await?,
    )?;
    Ok(with_etag(known_webhook(&state, id).await?))
}
