//! The deliveries of a webhook, and testing it.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::{known_webhook, unknown_webhook};
use crate::api::ApiState;
use crate::api::extract::{ApiPath, ApiQuery, NoQuery};
use crate::api::paging::{Listed, PageQuery, page};
use crate::api::parameters::WebhookParam;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::problem_responses::{WebhookProblems, WebhookTestProblems};
use crate::ids::WebhookId;
use crate::model::{DeliveryFailure, DeliveryStatus, WebhookEvent};
use crate::store::{AttemptEnd, DeliveryRecord, Subject, TestQueued};

/// The delivery of an event to a receiver.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDelivery)]
pub(in crate::api) struct DeliveryBody {
    /// The header `webhook-id`: the same for every attempt.
    #[schema(example = "msg_0f1e2d3c4b5a69788796a5b4c3d2e1f0")]
    id: String,
    /// What happened.
    #[serde(rename = "type")]
    event: WebhookEvent,
    /// The event's `id` in the stream of alerts; null if it is not about an alert.
    #[schema(required)]
    event_id: Option<i64>,
    /// The alert; null if the event is not about one.
    #[schema(required, format = "uuid")]
    alert_id: Option<String>,
    /// The batch; null if the event is not about one.
    #[schema(required)]
    batch_id: Option<String>,
    /// The vehicle; null if the event is not about one.
    #[schema(required)]
    vehicle_id: Option<String>,
    /// The operation; null if the event is not about one.
    #[schema(required, format = "uuid")]
    operation_id: Option<String>,
    /// When the event happened.
    #[schema(value_type = String, format = DateTime)]
    timestamp: Timestamp,
    /// Its status.
    status: DeliveryStatus,
    /// The number of attempts so far.
    attempts: i64,
    /// When the last attempt ended; null before the first.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    last_attempt_at: Option<Timestamp>,
    /// Status of the last answer; null if there was none.
    #[schema(required)]
    last_status_code: Option<u16>,
    /// Why the last attempt got no answer; null if it got one.
    #[schema(required)]
    last_failure: Option<DeliveryFailure>,
    /// The earliest time of the next attempt; null if there will be none.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    next_attempt_at: Option<Timestamp>,
}

page! {
    /// A page of the list of deliveries.
    #[schema(as = WebhookDeliveryPage)]
    pub(in crate::api) struct DeliveryPage {
        /// The newest first.
        items: Vec<DeliveryBody>,
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
/// Those of the last 30 days, the newest first; of successful ones at least the newest 1,000. Of the answers of
/// receivers only the status is stored.
#[utoipa::path(
    get, path = "/v1/webhooks/{webhook}/deliveries", tag = "webhooks",
    params(WebhookParam, PageQuery),
    responses((status = 200, description = "A page of the list", body = DeliveryPage), WebhookProblems)
)]
pub(in crate::api) async fn list_deliveries(
    State(state): State<ApiState>,
    ApiPath(id): ApiPath<WebhookId>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Listed<DeliveryPage>, Problem> {
    let wanted = query.wanted::<i64>()?;
    known_webhook(&state, id).await?;
    let deliveries = state.store.deliveries(id, wanted.after, wanted.to_read());
    Ok(wanted.page(
        deliveries.await?,
        |delivery| delivery.key,
        DeliveryBody::from,
    ))
}

/// Test a webhook.
///
/// Sends a signed `webhook.test` at once, whatever the webhook's events. There is a single attempt, whose outcome
/// is in the list of deliveries. While a test waits to be sent, no other is queued.
#[utoipa::path(
    post, path = "/v1/webhooks/{webhook}/test", tag = "webhooks",
    params(WebhookParam),
    responses((status = 202, description = "The test to be sent", body = DeliveryBody), WebhookTestProblems)
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
