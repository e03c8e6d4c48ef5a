//! Keys, sessions and roles in the OpenAPI document.

use serde_json::{Value, json};

use super::operations::{Needs, needs_of};

/// Adds the security schemes, and to each operation the schemes that it accepts and the role that it needs.
pub(in crate::api) fn add_security(document: &mut Value) {
    document["components"]["securitySchemes"] = json!({
        "key": {
            "type": "http",
            "scheme": "bearer",
            "description": "A key, as `POST /v1/keys` or `mapshift keys create` showed it. While no key exists, there is no authentication.",
        },
        "session": {
            "type": "apiKey",
            "in": "cookie",
            "name": "mapshift_session",
            "description": "A browser's session, begun with `POST /v1/session`. Changes also need an `Origin` of the service.",
        },
    });
    // The service's calls to webhooks are signed instead of authenticated.
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
