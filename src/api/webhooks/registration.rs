//! Registering webhooks.

use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;
use uuid::Uuid;

use super::body::{WebhookBody, check_description, checked_events};
use super::{known_webhook, url_refused, with_secret};
use crate::api::ApiState;
use crate::api::extract::NoQuery;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::WebhookRegistrationProblems;
use crate::api::upload::SmallJson;
use crate::ids::{RouteId, WebhookId};
use crate::model::{Actor, WebhookTopic};
use crate::store::{NewWebhook, Registered, WEBHOOKS_MAX};
use crate::webhooks::{generate_secret, secret_text};

/// A webhook to register.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"url": "https://hooks.example.com/mapshift", "route_id": "line-4"}))]
pub(in crate::api) struct WebhookRegistration {
    /// Where to send events: an https URL of a public host, up to 2,048 bytes.
    #[schema(format = "uri", max_length = 2048)]
    url: String,
    /// The events to send; those of alerts by default.
    #[schema(min_items = 1)]
    events: Option<Vec<WebhookTopic>>,
    /// Send only events of this route; of all routes if left out.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$", value_type = Option<String>)]
    route_id: Option<RouteId>,
    /// A description for people, up to 200 characters.
    #[schema(max_length = 200)]
    description: Option<String>,
    /// Whether to send tentative alerts, which have been observed in only one pass so far.
    #[serde(default)]
    #[schema(default = false)]
    include_tentative: bool,
}

impl WebhookRegistration {
    fn check(self, state: &ApiState) -> Result<NewWebhook, Problem> {
        let url = state.receivers.check_url(&self.url).map_err(url_refused)?;
        check_description(self.description.as_deref())?;
        Ok(NewWebhook {
            id: WebhookId(Uuid::now_v7()),
            url,
            secret: generate_secret().map_err(Problem::internal)?,
            events: checked_events(self.events.unwrap_or(WebhookTopic::DEFAULT.to_vec()))?,
            route_id: self.route_id,
            description: self.description,
            include_tentative: self.include_tentative,
            created_at: Timestamp::now(),
        })
    }
}

/// Register a webhook.
///
/// From now on, events are sent to the URL: signed according to Standard Webhooks, at least once each, and in
/// order while the receiver accepts them. `alert.updated` is sent when what a decision is about has changed
/// (status, kind, tier, region: `decision_revision`), not when evidence grows; an update that an earlier call
/// already contained is left out. An alert that is raised as tentative (observed in only one pass so far) is sent
/// as `alert.raised` once it is confirmed, or at once with `include_tentative`. The answer contains the secret
/// for checking signatures, which is shown only here. Registering the same URL again creates another webhook.
#[utoipa::path(
    post, path = "/v1/webhooks", tag = "webhooks",
    request_body(content = WebhookRegistration, description = "Where to send events, and which"),
    responses((status = 201, description = "Registered; with its secret", body = WebhookBody, headers(
        ("ETag" = String, description = "Changes with every edit"),
        ("Location" = String, description = "Path of the webhook"),
    )), WebhookRegistrationProblems)
)]
pub(in crate::api) async fn register_webhook(
    State(state): State<ApiState>,
    _: NoQuery,
    by: Actor,
    SmallJson(registration): SmallJson<WebhookRegistration>,
) -> Result<Response, Problem> {
    let webhook = registration.check(&state)?;
    let (id, secret) = (webhook.id, secret_text(&webhook.secret));
    match state.store.register_webhook(webhook, &by).await? {
        Registered::Created => {}
        Registered::UnknownRoute => return Err(Problem::unknown_route().at("/route_id")),
        Registered::TooMany => {
            let detail =
                format!("there are already {WEBHOOKS_MAX} webhooks: delete one that is not used");
            return Err(Problem::new(ProblemKind::TooManyWebhooks, detail));
        }
    }
    let webhook = known_webhook(&state, id).await?;
    let location = [(header::LOCATION, format!("/v1/webhooks/{id}"))];
    Ok((StatusCode::CREATED, location, with_secret(webhook, secret)).into_response())
}
