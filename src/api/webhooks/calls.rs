//! The calls that webhooks make, as the OpenAPI document tells them.

use serde_json::{Value, json};

use crate::model::AlertEventKind;

/// Adds what receivers are sent to a document that has the schema of alerts.
pub(in crate::api) fn add_calls(document: &mut Value) {
    document["webhooks"] = json!({"alert": {"post": call()}});
    document["components"]["schemas"]["WebhookMessage"] = message();
}

fn call() -> Value {
    let header = |name: &str, description: &str, example: &str| {
        json!({
            "name": name, "in": "header", "required": true, "description": description,
            "schema": {"type": "string"}, "example": example
        })
    };
    json!({
        "operationId": "receive_alert",
        "tags": ["webhooks"],
        "summary": "Be told of an alert.",
        "description": "What a receiver is sent. A `webhook.test` comes with the same headers; its `data` has a `webhook_id` and a `message`.",
        "parameters": [
            header("webhook-id", "The same for every attempt", "msg_0f1e2d3c4b5a69788796a5b4c3d2e1f0"),
            header("webhook-timestamp", "When this attempt was made: seconds since the Unix epoch", "1795154409"),
            header("webhook-signature", "`v1,` and the base64 of HMAC-SHA256 over `webhook-id.webhook-timestamp.body`", "v1,Wca+HubgWG90acgyHFAaj/r+OMbXJ48ibPLwHJ4/wbk="),
        ],
        "requestBody": {
            "required": true,
            "content": {"application/json": {"schema": {"$ref": "#/components/schemas/WebhookMessage"}}}
        },
        "responses": {
            "204": {"description": "Taken; any 2xx is as good"},
            "410": {"description": "Gone: the webhook is disabled"},
            "503": {"description": "Not now: sent again after `Retry-After`. Every other answer is a failure, and it is sent again as well"}
        }
    })
}

fn message() -> Value {
    json!({
        "type": "object",
        "description": "What a receiver is sent.",
        "required": ["type", "timestamp", "data"],
        "properties": {
            "type": {
                "type": "string", "enum": AlertEventKind::ALL,
                "description": "What happened. To a webhook without `include_tentative` an alert is raised when it is first confirmed."
            },
            "timestamp": {
                "type": "string", "format": "date-time", "description": "When it happened."
            },
            "data": {"$ref": "#/components/schemas/Alert"}
        }
    })
}
