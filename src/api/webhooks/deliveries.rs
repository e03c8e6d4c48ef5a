//! What became of the events that a webhook was to be sent, and trying a webhook out.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::{known_webhook, unknown_webhook};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, ApiQuery, NoQuery, PageQuery};
use crate::api::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use crate::api::parameters::WebhookParam;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::{WebhookProblems, WebhookTestProblems};
use crate::ids::WebhookId;
use crate::model::{DeliveryFailure, DeliveryStatus, WebhookEvent};
use crate::store::{AttemptEnd, DeliveryRecord, Subject, TestQueued};

/// An event on its way to a receiver.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDelivery)]
pub(in crate::api) struct DeliveryBody {
    /// The header `webhook-id`: the same for every attempt.
    #[schema(example = "msg_0f1e2d3c4b5a69788796a5b4c3d2e1f0")]
    id: String,
    /// What happened.
    #[serde(rename = "type")]
    event: WebhookEvent,
    /// The event's `id` in the stream of alerts; null for what is about no alert.
    #[schema(required)]
    event_id: Option<i64>,
    /// The alert; null for what is about no alert.
    #[schema(required, format = "uuid")]
    alert_id: Option<String>,
    /// The batch; null for what is about no batch.
    #[schema(required)]
    batch_id: Option<String>,
    /// The vehicle; null for what is about no vehicle.
    #[schema(required)]
    vehicle_id: Option<String>,
    /// The operation; null for what is about no operation.
    #[schema(required, format = "uuid")]
    operation_id: Option<String>,
    /// When the event happened.
    #[schema(value_type = String, format = DateTime)]
    timestamp: Timestamp,
    /// How far it has come.
    status: DeliveryStatus,
    /// Attempts so far.
    attempts: i64,
    /// When the last one ended; null before the first.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    last_attempt_at: Option<Timestamp>,
    /// Status of the last answer; null if there was none.
    #[schema(required)]
    last_status_code: Option<u16>,
    /// Why there was no answer last; null if there was one.
    #[schema(required)]
    last_failure: Option<DeliveryFailure>,
    /// When the next attempt follows, at the earliest; null if none follows.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    next_attempt_at: Option<Timestamp>,
}

/// A part of the list of deliveries.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDeliveryPage)]
pub(in crate::api) struct DeliveryPage {
    /// The newest first.
    items: Vec<DeliveryBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for DeliveryPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

impl From<DeliveryRecord> for DeliveryBody {
    fn from(delivery: DeliveryRecord) -> Self {
        let (last_status_code, last_failure) = match delivery.last_end {
            None => (None, None),
            Some(AttemptEnd::Answer(status)) => (Some(status), None),
            Some(AttemptEnd::Failure(failure)) => (None, Some(failure)),
        };
        let (mut alert_id, mut batch_id, mut vehicle_id, mut operation_id) =
            (None, None, None, None);
        match delivery.subject {
            None => {}
            Some(Subject::Alert(id)) => alert_id = Some(id.to_string()),
            Some(Subject::Batch(_, id)) => batch_id = Some(id.to_string()),
            Some(Subject::Vehicle(_, id)) => vehicle_id = Some(id.to_string()),
            Some(Subject::Operation(id)) => operation_id = Some(id.to_string()),
        }
        Self {
            id: delivery.id,
            event: delivery.event,
            event_id: delivery.event_sequence,
            alert_id,
            batch_id,
            vehicle_id,
            operation_id,
            timestamp: delivery.at,
            status: delivery.status,
            attempts: delivery.attempts,
            last_attempt_at: delivery.attempted_at,
            last_status_code,
            last_failure,
            next_attempt_at: delivery.next_attempt_at,
        }
    }
}

/// List a webhook's deliveries.
///
/// Of the last 30 days, the newest first, in parts; of what was delivered at least the newest
/// 1,000. What receivers answer beside a status is neither kept nor shown.
#[utoipa::path(
    get, path = "/v1/webhooks/{webhook}/deliveries", tag = "webhooks",
    params(WebhookParam, PageQuery),
    responses((status = 200, description = "A part of the list", body = DeliveryPage), WebhookProblems)
)]
pub(in crate::api) async fn list_deliveries(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<DeliveryPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let before: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    known_webhook(&state, id).await?;
    let mut deliveries = state.store.deliveries(id, before, limit + 1).await?;
    let next_cursor = cut_page(&mut deliveries, limit, |delivery| delivery.key.to_string());
    Ok(Listed(DeliveryPage {
        items: deliveries.into_iter().map(DeliveryBody::from).collect(),
        next_cursor,
    }))
}

/// Try a webhook out.
///
/// Sends a signed `webhook.test` at once, whatever events the webhook is for. It is tried a single
/// time; the list of deliveries says what became of it. While a test waits, no other is queued.
#[utoipa::path(
    post, path = "/v1/webhooks/{webhook}/test", tag = "webhooks",
    params(WebhookParam),
    responses((status = 202, description = "The test, as it is sent next", body = DeliveryBody), WebhookTestProblems)
)]
pub(in crate::api) async fn test_webhook(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    _: NoQuery,
) -> Result<Response, Problem> {
    match state.store.queue_webhook_test(id, Timestamp::now()).await? {
        TestQueued::Queued(delivery) => {
            let body = DeliveryBody::from(delivery);
            Ok((StatusCode::ACCEPTED, Json(body)).into_response())
        }
        TestQueued::Unknown => Err(unknown_webhook()),
        TestQueued::Disabled => {
            let detail = "the webhook is not active: change it to {\"active\": true} first";
            Err(Problem::new(ProblemKind::WebhookDisabled, detail))
        }
    }
}
