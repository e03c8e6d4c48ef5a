//! The OpenAPI document: what the handlers declare, and what is true of all of them.

use serde_json::{Map, Value, json};
use utoipa::OpenApi;

use super::problem::{FieldError, ProblemBody, ProblemKind};
use super::webhooks::add_calls;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "mapshift",
        description = "Tells the keepers of a map where the world has changed.\n\nVehicles upload batches of 2D lidar scans, the service keeps one pose graph per route and watches its residuals. Metres, radians, seconds; x forward, y left, counter-clockwise (REP-103); times in UTC (RFC 3339). Errors are problem details (RFC 9457).",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    servers((url = "/", description = "This service")),
    tags(
        (name = "routes", description = "A route has one map and one pose graph"),
        (name = "batches", description = "Uploads of scans or edges"),
        (name = "graph", description = "Nodes, edges, trajectories"),
        (name = "vehicles", description = "Who drives, and how it is calibrated"),
        (name = "residuals", description = "The statistics that tell a changed world"),
        (name = "alerts", description = "Where the world has changed, and what was decided about it"),
        (name = "webhooks", description = "Who is told of alerts by a POST: signed as Standard Webhooks has it, with the bytes whose base64 follows `whsec_` in the secret as key"),
        (name = "map", description = "Pictures and versions of the map"),
        (name = "operations", description = "For those who run the service")
    ),
    components(schemas(ProblemBody, FieldError))
)]
pub(super) struct Document;

/// Completes a document: every operation gets the problems that any operation of its shape can
/// end in, so that no handler can forget one.
///
/// # Errors
/// If the document does not serialise.
pub(super) fn complete(document: &utoipa::openapi::OpenApi) -> Result<Value, serde_json::Error> {
    let mut document = serde_json::to_value(document)?;
    let paths = document.get_mut("paths").and_then(Value::as_object_mut);
    for (path, item) in paths.into_iter().flatten() {
        for (method, operation) in item.as_object_mut().into_iter().flatten() {
            if let Some(operation) = operation.as_object_mut() {
                add_problems(path, method, operation);
            }
        }
    }
    add_calls(&mut document);
    Ok(document)
}

fn add_problems(path: &str, method: &str, operation: &mut Map<String, Value>) {
    use ProblemKind as K;
    let mut kinds = vec![
        K::InvalidParameter,
        K::Internal,
        K::Overloaded,
        K::ShuttingDown,
    ];
    if path.contains("{route}") {
        kinds.push(K::InvalidField);
        if method != "put" || path != "/v1/routes/{route}" {
            kinds.push(K::UnknownRoute);
        }
    }
    let below_route = path.strip_prefix("/v1/routes/{route}/").unwrap_or_default();
    if method == "get"
        && (below_route.contains('{')
            || below_route.starts_with("map.")
            || below_route == "residuals")
    {
        kinds.push(K::NotFound);
    }
    let takes_body = operation.contains_key("requestBody");
    if takes_body {
        kinds.extend([
            K::MalformedJson,
            K::BodyTimeout,
            K::TooLarge,
            K::UnsupportedMediaType,
        ]);
        kinds.extend([K::UnsupportedEncoding, K::OutOfRange, K::DiskFull]);
    }
    if path == "/v1/routes/{route}" && method != "get" {
        kinds.extend([K::PreconditionFailed, K::DiskFull]);
        if takes_body {
            kinds.push(K::DetectorFixed);
        }
    }
    if takes_body && below_route.ends_with("batches/{batch}") {
        kinds.extend([K::BadEncoding, K::DigestMismatch, K::BatchIdReused]);
        kinds.extend(match below_route {
            "batches/{batch}" => [K::ScanGeometry, K::TimestampOrder].as_slice(),
            _ => &[K::EdgeGraph],
        });
    }
    if path.starts_with("/v1/alerts") {
        kinds.extend(of_alerts(path, method));
    }
    if path.starts_with("/v1/webhooks") {
        kinds.extend(of_webhooks(path, method));
    }
    if path == "/readyz" {
        kinds.push(K::NotReady);
    }
    let responses = operation.entry("responses").or_insert_with(|| json!({}));
    let Some(responses) = responses.as_object_mut() else {
        return;
    };
    for kind in K::ALL.iter().filter(|kind| kinds.contains(kind)) {
        add_problem(responses, *kind);
    }
}

/// What operations on alerts can end in beside the rest.
fn of_alerts(path: &str, method: &str) -> Vec<ProblemKind> {
    use ProblemKind as K;
    let mut kinds = if path.contains("{alert}") {
        vec![K::InvalidField, K::NotFound]
    } else {
        vec![K::UnknownRoute]
    };
    if path.ends_with(".geojson") {
        kinds.push(K::NoGeoAnchor);
    }
    if method == "post" {
        kinds.extend([K::PreconditionRequired, K::PreconditionFailed]);
        kinds.push(K::TransitionNotAllowed);
    }
    kinds
}

/// What operations on webhooks can end in beside the rest.
fn of_webhooks(path: &str, method: &str) -> Vec<ProblemKind> {
    use ProblemKind as K;
    let mut kinds = Vec::new();
    if path.contains("{webhook}") {
        kinds.extend([K::InvalidField, K::NotFound]);
    }
    match (path, method) {
        (_, "get") => return kinds,
        ("/v1/webhooks", _) => kinds.extend([K::UnknownRoute, K::TooManyWebhooks]),
        (path, _) if path.ends_with("/test") => kinds.push(K::WebhookDisabled),
        _ => kinds.push(K::PreconditionFailed),
    }
    if ["post", "patch"].contains(&method) && !path.ends_with("/test") {
        kinds.extend([K::InvalidField, K::WebhookUrlRefused]);
    }
    kinds.push(K::DiskFull);
    kinds
}

fn add_problem(responses: &mut Map<String, Value>, kind: ProblemKind) {
    let sentence = format!("`{}`: {}", kind.name(), kind.title());
    let response = responses
        .entry(kind.status().as_str())
        .or_insert_with(|| problem_response(kind));
    if let Some(Value::String(description)) = response.get_mut("description") {
        if !description.is_empty() {
            description.push_str(". ");
        }
        description.push_str(&sentence);
    }
}

fn problem_response(kind: ProblemKind) -> Value {
    let mut response = json!({
        "description": "",
        "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    });
    if [503, 507].contains(&kind.status().as_u16()) {
        response["headers"] = json!({
            "Retry-After": {"description": "Seconds to wait before the same request is sent again", "schema": {"type": "string"}}
        });
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::openapi_document;

    fn operations(document: &Value) -> Vec<(String, Value)> {
        let mut operations = Vec::new();
        for (path, item) in document["paths"].as_object().unwrap() {
            for (method, operation) in item.as_object().unwrap() {
                operations.push((format!("{method} {path}"), operation.clone()));
            }
        }
        operations
    }

    #[test]
    fn every_operation_is_described_once() {
        let document = openapi_document().unwrap();
        let mut ids = Vec::new();
        for (name, operation) in operations(&document) {
            for field in ["operationId", "summary", "description"] {
                let text = operation[field].as_str().unwrap_or_default();
                assert!(!text.is_empty(), "{name} has no {field}");
            }
            ids.push(operation["operationId"].as_str().unwrap().to_owned());
            for (status, response) in operation["responses"].as_object().unwrap() {
                assert!(
                    !response["description"].as_str().unwrap().is_empty(),
                    "{name} {status}"
                );
                let types = response["content"].as_object().map_or(0, Map::len);
                assert!(types <= 1, "{name} {status}");
            }
            for parameter in operation["parameters"].as_array().into_iter().flatten() {
                assert!(parameter["description"].is_string(), "{name} {parameter}");
            }
        }
        let count = ids.len();
        ids.sort();
        ids.dedup();
        assert_eq!(ids.len(), count, "operation ids repeat");
    }

    #[test]
    fn every_response_field_is_required_and_no_schema_is_a_bare_choice() {
        let document = openapi_document().unwrap();
        for (name, schema) in document["components"]["schemas"].as_object().unwrap() {
            assert!(schema.get("anyOf").is_none(), "{name}");
            if let Some(choices) = schema.get("oneOf").and_then(Value::as_array) {
                assert!(choices.iter().all(|c| c["type"] == "string"), "{name}");
            }
            let sent_by_clients = [
                "Put",
                "Upload",
                "InitialPose",
                "Lidar",
                "HeightBand",
                "Decision",
                "Registration",
                "Change",
            ];
            let is_request = sent_by_clients.iter().any(|end| name.ends_with(end));
            let properties = schema["properties"].as_object();
            for property in properties.into_iter().flatten().map(|(name, _)| name) {
                let required = schema["required"].as_array();
                let is_required = required.is_some_and(|r| r.iter().any(|v| v == property));
                assert!(is_request || is_required, "{name}.{property}");
            }
        }
    }

    #[test]
    fn every_reference_leads_somewhere() {
        fn visit(value: &Value, document: &Value) {
            if let Some(reference) = value.get("$ref").and_then(Value::as_str) {
                let pointer = reference.trim_start_matches('#');
                assert!(document.pointer(pointer).is_some(), "{reference}");
            }
            match value {
                Value::Object(fields) => fields.values().for_each(|v| visit(v, document)),
                Value::Array(items) => items.iter().for_each(|v| visit(v, document)),
                _ => {}
            }
        }
        let document = openapi_document().unwrap();
        visit(&document, &document);
    }
}
