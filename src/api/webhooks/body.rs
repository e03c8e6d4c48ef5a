//! A webhook as clients see it.

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::problem::{Problem, ProblemKind};
use crate::model::WebhookTopic;
use crate::store::WebhookRecord;

const DESCRIPTION_CHARS_MAX: usize = 200;

/// A receiver to which events are POSTed.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Webhook, example = json!({
    "id": "019aa000-0000-7000-8000-00000000a001", "url": "https://hooks.example.com/mapshift",
    "events": ["alert.raised", "alert.updated"], "route_id": null, "description": "tickets",
    "include_tentative": false, "active": true, "gone_at": null, "secret": null,
    "previous_secret_until": null,
    "created_at": "2026-11-20T06:00:00Z", "updated_at": "2026-11-20T06:00:00Z"
}))]
pub(in crate::api) struct WebhookBody {
    /// UUID of version 7: sorts by the time of registration.
    #[schema(format = "uuid")]
    id: String,
    /// Where events are sent.
    #[schema(format = "uri")]
    url: String,
    /// The events that are sent.
    events: Vec<WebhookTopic>,
    /// The route whose events are sent; null for all routes.
    #[schema(required)]
    route_id: Option<String>,
    /// A description for people.
    #[schema(required)]
    description: Option<String>,
    /// Whether tentative alerts are sent. If not, `alert.raised` is sent when an alert is first confirmed.
    include_tentative: bool,
    /// Whether events are sent. Events that occur while it is inactive are not sent later.
    active: bool,
    /// When the receiver answered 410 Gone, which disabled the webhook; null otherwise.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    gone_at: Option<Timestamp>,
    /// The secret that calls are signed with: `whsec_` followed by base64. Shown once, in the answer to the
    /// registration or to `rotate-secret`; null in every other answer.
    #[schema(required)]
    pub secret: Option<String>,
    /// Until when calls are also signed with the previous secret; null if that is no longer valid.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    previous_secret_until: Option<Timestamp>,
    /// When it was registered.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// When it last changed.
    #[schema(value_type = String, format = DateTime)]
    updated_at: Timestamp,
}

impl From<WebhookRecord> for WebhookBody {
    fn from(webhook: WebhookRecord) -> Self {
        Self {
            id: webhook.id.to_string(),
            url: webhook.url,
            events: webhook.events,
            route_id: webhook.route_id.map(|route| route.to_string()),
            description: webhook.description,
            include_tentative: webhook.include_tentative,
            active: webhook.active,
            gone_at: webhook.gone_at,
            secret: None,
            previous_secret_until: webhook
                .previous_secret_until
                .filter(|until| Timestamp::now() < *until),
            created_at: webhook.created_at,
            updated_at: webhook.updated_at,
        }
    }
}

/// The ETag of a webhook.
pub(super) fn etag(webhook: &WebhookRecord) -> String {
    format!("\"{}\"", webhook.revision)
}

/// Events in a fixed order, each once.
///
/// # Errors
/// 422 for an empty list: such a webhook would never be called.
pub(super) fn checked_events(mut events: Vec<WebhookTopic>) -> Result<Vec<WebhookTopic>, Problem> {
    events.sort_unstable();
    events.dedup();
    if events.is_empty() {
        let detail = "name an event, or leave events out for those of alerts";
        return Err(Problem::new(ProblemKind::OutOfRange, detail).at("/events"));
    }
    Ok(events)
}

/// Checks a description for people.
///
/// # Errors
/// 422 for one that is too long or has control characters.
pub(super) fn check_description(text: Option<&str>) -> Result<(), Problem> {
    let is_fit = |text: &str| {
        text.chars().count() <= DESCRIPTION_CHARS_MAX && !text.chars().any(char::is_control)
    };
    if text.is_none_or(is_fit) {
        return Ok(());
    }
    let detail = "a description has at most 200 characters and no control characters";
    Err(Problem::new(ProblemKind::OutOfRange, detail).at("/description"))
}
