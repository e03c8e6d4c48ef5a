//! Changing webhooks.

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
use crate::api::parameters::{IfMatch, WebhookParam};
use crate::api::problem::Problem;
use crate::api::problem_responses::WebhookChangeProblems;
use crate::api::upload::SmallJson;
use crate::ids::WebhookId;
use crate::model::{Actor, WebhookTopic};
use crate::store::WebhookUpdate;

/// What to change of a webhook; fields that are left out keep their value.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"active": false}))]
pub(in crate::api) struct WebhookChange {
    /// Where to send events: an https URL of a public host, up to 2,048 bytes.
    #[schema(format = "uri", max_length = 2048)]
    url: Option<String>,
    /// The events to send.
    #[schema(min_items = 1)]
    events: Option<Vec<WebhookTopic>>,
    /// A description for people, up to 200 characters.
    #[schema(max_length = 200)]
    description: Option<String>,
    /// Whether to send tentative alerts, which have been observed in only one pass so far.
    include_tentative: Option<bool>,
    /// Whether to send events.
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
/// Fields that are left out keep their value; the secret and the route cannot be changed here. While a webhook
/// is inactive nothing is sent: deliveries that await another attempt keep waiting, and events that occur in
/// the meantime are not sent later.
#[utoipa::path(
    patch, path = "/v1/webhooks/{webhook}", tag = "webhooks",
    params(WebhookParam, IfMatch),
    request_body(content = WebhookChange, description = "What to change"),
    responses((status = 200, description = "The webhook as it is now", body = WebhookBody, headers(("ETag" = String, description = "Changes with every edit"))), WebhookChangeProblems)
)]
pub(in crate::api) async fn change_webhook(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    _: NoQuery,
    by: Actor,
    headers: HeaderMap,
    SmallJson(change): SmallJson<WebhookChange>,
) -> Result<Response, Problem> {
    let revision = wanted_revision(&headers, &known_webhook(&state, id).await?)?;
    let update = change.check(&state)?;
    let now = Timestamp::now();
    let updated = state.store.update_webhook(id, revision, update, &by, now);
    check_edited(updated.await?)?;
    Ok(with_etag(known_webhook(&state, id).await?))
}
