//! What the OpenAPI document says of keys, sessions and roles.

use serde_json::{Value, json};

use super::operations::{Needs, needs_of};

/// Adds the ways to show who one is, and to each operation which of them it takes and the role that
/// it needs.
pub(in crate::api) fn add_security(document: &mut Value) {
    document["components"]["securitySchemes"] = json!({
        "key": {
            "type": "http",
            "scheme": "bearer",
            "description": "A key, as `POST /v1/keys` or `mapshift keys create` has shown it. While there is none, the service asks nobody who they are.",
        },
        "session": {
            "type": "apiKey",
            "in": "cookie",
            "name": "mapshift_session",
            "description": "A session of a browser, as `POST /v1/session` begins it. Changes also need an `Origin` of the service.",
        },
    });
    // Calls of the service to others are signed, and bring nothing that shows who calls.
    let calls = document["webhooks"].as_object_mut().into_iter().flatten();
    for (_, item) in calls {
        for (_, call) in item.as_object_mut().into_iter().flatten() {
            call["security"] = json!([]);
        }
    }
    let items = document["paths"].as_object_mut().into_iter().flatten();
    for (_, item) in items {
        for (_, operation) in item.as_object_mut().into_iter().flatten() {
            add_to(operation);
        }
    }
}

fn add_to(operation: &mut Value) {
    let id = operation["operationId"].as_str().unwrap_or_default();
    let Some((needs, _)) = needs_of(id) else {
        return;
    };
    let (Some(roles), Some(least)) = (needs.roles(), needs.least_role()) else {
        operation["security"] = match needs {
            Needs::Identity => json!([{}, {"key": []}, {"session": []}]),
            _ => json!([]),
        };
        return;
    };
    operation["security"] = json!([{"key": []}, {"session": []}]);
    operation["x-required-role"] = json!(least.name());
    let description = operation["description"].as_str().unwrap_or_default();
    operation["description"] = json!(format!("{description}\n\nRole: {roles}."));
}
