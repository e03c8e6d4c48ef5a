//! The calls that webhooks make, for the OpenAPI document.

use serde_json::{Value, json};

use crate::model::WebhookTopic;

/// A call about one kind of subject.
struct Call {
    /// Its name in the document, and that of its operation after `receive_`.
    name: &'static str,
    summary: &'static str,
    topics: &'static [WebhookTopic],
    /// The schemas of the message and of its `data`.
    message: &'static str,
    data: &'static str,
    url: &'static str,
}

const CALLS: [Call; 4] = [
    Call {
        name: "alert",
        summary: "An alert was raised, or its status, tier, kind or region has changed. For a webhook without `include_tentative`, `alert.raised` is sent when an alert is first confirmed.",
        topics: &[WebhookTopic::AlertRaised, WebhookTopic::AlertUpdated],
        message: "WebhookMessage",
        data: "Alert",
        url: "The alert in the console; null if the service has no public URL (`--public-url`).",
    },
    Call {
        name: "batch",
        summary: "An upload was kept out of the map; `data.reason` says why.",
        topics: &[WebhookTopic::BatchQuarantined],
        message: "BatchMessage",
        data: "Batch",
        url: "The route's batches in the console; null if the service has no public URL.",
    },
    Call {
        name: "vehicle",
        summary: "A vehicle has become suspect or quarantined; `data.reasons` says why.",
        topics: &[WebhookTopic::VehicleSuspect],
        message: "VehicleMessage",
        data: "Vehicle",
        url: "The route's vehicles in the console; null if the service has no public URL.",
    },
    Call {
        name: "operation",
        summary: "An operation has ended; `data.status` says how.",
        topics: &[WebhookTopic::OperationFinished],
        message: "OperationMessage",
        data: "Operation",
        url: "Always null: the console does not show operations.",
    },
];

/// Adds the calls to a document that has the schemas of their subjects.
pub(in crate::api) fn add_calls(document: &mut Value) {
    for call in &CALLS {
        document["webhooks"][call.name] = json!({"post": operation(call)});
        document["components"]["schemas"][call.message] = message(call);
    }
}

fn operation(call: &Call) -> Value {
    let header = |name: &str, description: &str, example: &str| {
        json!({
            "name": name, "in": "header", "required": true, "description": description,
            "schema": {"type": "string"}, "example": example
        })
    };
    json!({
        "operationId": format!("receive_{}", call.name),
        "tags": ["webhooks"],
        "summary": format!("Receive events of {}s.", call.name),
        "description": format!("{} A `webhook.test` has the same headers; its `data` has a `webhook_id` and a `message`, and its `url` is null.", call.summary),
        "parameters": [
            header("webhook-id", "The same for every attempt", "msg_0f1e2d3c4b5a69788796a5b4c3d2e1f0"),
            header("webhook-timestamp", "The time of this attempt: seconds since the Unix epoch", "1795154409"),
            header("webhook-signature", "`v1,` and the base64 of HMAC-SHA256 over `webhook-id.webhook-timestamp.body`; two signatures, separated by a space, while a replaced secret is still valid", "v1,Wca+HubgWG90acgyHFAaj/r+OMbXJ48ibPLwHJ4/wbk="),
        ],
        "requestBody": {
            "required": true,
            "content": {"application/json": {"schema": {"$ref": format!("#/components/schemas/{}", call.message)}}}
        },
        "responses": {
            "204": {"description": "Received; any 2xx status will do"},
            "410": {"description": "Gone: the webhook is disabled"},
            "503": {"description": "Not now: sent again after `Retry-After`. Every other status is a failure and is sent again too"}
        }
    })
}

fn message(call: &Call) -> Value {
    json!({
        "type": "object",
        "description": "The body of a call.",
        "required": ["type", "timestamp", "url", "data"],
        "properties": {
            "type": {"type": "string", "enum": call.topics, "description": "What happened."},
            "timestamp": {
                "type": "string", "format": "date-time", "description": "When it happened."
            },
            "url": {"type": ["string", "null"], "format": "uri", "description": call.url},
            "data": {"$ref": format!("#/components/schemas/{}", call.data)}
        }
    })
}
