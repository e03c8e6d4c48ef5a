//! The calls that webhooks make, as the OpenAPI document describes them.

use serde_json::{Value, json};

use crate::model::WebhookTopic;

/// What receivers are sent that is about one kind of thing.
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
        summary: "An alert was raised, or what a decision about it is about has changed. To a webhook without `include_tentative` an alert is raised when it is first confirmed.",
        topics: &[WebhookTopic::AlertRaised, WebhookTopic::AlertUpdated],
        message: "WebhookMessage",
        data: "Alert",
        url: "The alert on the maintainers' page; null if the service does not know where people reach it (`--public-url`).",
    },
    Call {
        name: "batch",
        summary: "An upload was kept out of the map; `data.reason` says why.",
        topics: &[WebhookTopic::BatchQuarantined],
        message: "BatchMessage",
        data: "Batch",
        url: "The route's batches on the maintainers' page; null if the service does not know where people reach it.",
    },
    Call {
        name: "vehicle",
        summary: "A vehicle has become suspect or quarantined; `data.reasons` says why.",
        topics: &[WebhookTopic::VehicleSuspect],
        message: "VehicleMessage",
        data: "Vehicle",
        url: "The route's vehicles on the maintainers' page; null if the service does not know where people reach it.",
    },
    Call {
        name: "operation",
        summary: "An operation has ended; `data.status` says how.",
        topics: &[WebhookTopic::OperationFinished],
        message: "OperationMessage",
        data: "Operation",
        url: "Null: operations have no place on the maintainers' page.",
    },
];

/// Adds what receivers are sent to a document that has the schemas of what it is about.
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
        "description": format!("{} A `webhook.test` comes with the same headers; its `data` has a `webhook_id` and a `message`, its `url` is null.", call.summary),
        "parameters": [
            header("webhook-id", "The same for every attempt", "msg_0f1e2d3c4b5a69788796a5b4c3d2e1f0"),
            header("webhook-timestamp", "When this attempt was made: seconds since the Unix epoch", "1795154409"),
            header("webhook-signature", "`v1,` and the base64 of HMAC-SHA256 over `webhook-id.webhook-timestamp.body`; two of them, separated by a space, while a replaced secret is still valid", "v1,Wca+HubgWG90acgyHFAaj/r+OMbXJ48ibPLwHJ4/wbk="),
        ],
        "requestBody": {
            "required": true,
            "content": {"application/json": {"schema": {"$ref": format!("#/components/schemas/{}", call.message)}}}
        },
        "responses": {
            "204": {"description": "Taken; any 2xx is as good"},
            "410": {"description": "Gone: the webhook is disabled"},
            "503": {"description": "Not now: sent again after `Retry-After`. Every other answer is a failure, and it is sent again as well"}
        }
    })
}

fn message(call: &Call) -> Value {
    json!({
        "type": "object",
        "description": "What a receiver is sent.",
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
