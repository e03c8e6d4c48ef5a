//! The OpenAPI document: what the handlers declare, and what is true of all of them. Enumerations have
//! their schemas in `enum_schemas`, repeated parameters and errors in `parameters` and
//! `problem_responses`.

use serde_json::Value;
use utoipa::OpenApi;

use super::access::add_security;
use super::paging::document_links;
use super::problem::{FieldError, ProblemBody};
use super::traffic::document_names;
use super::webhooks::add_calls;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "mapshift",
        description = "Tells the keepers of a map where the world has changed.\n\nVehicles upload batches of 2D lidar scans, the service keeps one pose graph per route and watches its residuals. Metres, radians, seconds; x forward, y left, counter-clockwise (REP-103); times in UTC (RFC 3339). Errors are problem details (RFC 9457); the `type` of each leads to a page that explains it, and `/problems` lists them. A list is read in parts: `next_cursor`, and the header `Link`, lead to the next one.",
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
        (name = "audit", description = "Who changed what, when, and from where"),
        (name = "access", description = "Keys, and sessions of people who have signed in with one"),
        (name = "operations", description = "For those who run the service")
    ),
    components(schemas(ProblemBody, FieldError))
)]
pub(super) struct Document;

/// The document with what no handler declares: the calls that webhooks make, who may use what, and which
/// answers need not be sent again.
///
/// # Errors
/// If the document does not serialise.
pub(super) fn complete(document: &utoipa::openapi::OpenApi) -> Result<Value, serde_json::Error> {
    let mut document = serde_json::to_value(document)?;
    add_calls(&mut document);
    add_security(&mut document);
    document_names(&mut document);
    document_links(&mut document);
    document_bodies(&mut document);
    Ok(document)
}

/// Says that a body of which no field is required may be left out: no body counts as `{}`.
fn document_bodies(document: &mut Value) {
    let schemas = document["components"]["schemas"].clone();
    let items = document["paths"].as_object_mut().into_iter().flatten();
    let operations = items.flat_map(|(_, item)| item.as_object_mut().into_iter().flatten());
    for (_, operation) in operations {
        let reference = &operation["requestBody"]["content"]["application/json"]["schema"]["$ref"];
        let name = reference.as_str().and_then(|r| r.rsplit('/').next());
        if name.is_some_and(|name| schemas[name].get("required").is_none()) {
            operation["requestBody"]["required"] = Value::Bool(false);
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Map;

    use super::*;
    use crate::api::openapi_document;
    use crate::api::problem::ProblemKind;

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
    fn every_operation_declares_its_problems() {
        let document = openapi_document().unwrap();
        for (name, operation) in operations(&document) {
            let responses = operation["responses"].as_object().unwrap();
            let declares = |kind: ProblemKind| {
                let response = responses.get(kind.status().as_str());
                let description = response.and_then(|r| r["description"].as_str());
                description.is_some_and(|d| d.contains(&format!("`{}`", kind.name())))
            };
            use ProblemKind as K;
            assert!(declares(K::InvalidParameter), "{name}");
            assert!(declares(K::Internal) && declares(K::ShuttingDown), "{name}");
            let takes_body = operation.get("requestBody").is_some();
            assert_eq!(declares(K::MalformedJson), takes_body, "{name}");
            let names_something = name.contains('{');
            assert_eq!(
                declares(K::InvalidField),
                names_something || takes_body,
                "{name}"
            );
            let missing = declares(K::UnknownRoute) || declares(K::NotFound);
            assert!(
                missing || !names_something || name.starts_with("put "),
                "{name}"
            );
            let writes = !name.starts_with("get ");
            assert_eq!(declares(K::DiskFull), writes, "{name}");
        }
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
                "Edit",
                "Post",
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

    /// What a body of a request may hold is said in full: other fields are refused.
    #[test]
    fn every_object_of_a_request_is_closed() {
        fn visit(schema: &Value, document: &Value, at: &str, seen: &mut Vec<String>) {
            if let Some(reference) = schema.get("$ref").and_then(Value::as_str)
                && !seen.iter().any(|other| other == reference)
            {
                seen.push(reference.to_owned());
                let target = document.pointer(reference.trim_start_matches('#'));
                visit(target.unwrap(), document, reference, seen);
            }
            if schema.get("properties").is_some() {
                assert_eq!(schema["additionalProperties"], false, "{at}");
            }
            match schema {
                Value::Object(fields) => {
                    let parts = fields.iter().filter(|(key, _)| !key.starts_with("example"));
                    parts.for_each(|(_, part)| visit(part, document, at, seen));
                }
                Value::Array(items) => items.iter().for_each(|v| visit(v, document, at, seen)),
                _ => {}
            }
        }
        let document = openapi_document().unwrap();
        let mut seen = Vec::new();
        for (name, operation) in operations(&document) {
            if let Some(body) = operation.get("requestBody") {
                visit(&body["content"], &document, &name, &mut seen);
            }
        }
        for known in [
            "BatchUpload",
            "NamedLidar",
            "EdgeUpload",
            "RoutePut",
            "ZoneEdit",
        ] {
            let reference = format!("#/components/schemas/{known}");
            assert!(seen.contains(&reference), "{known} was not seen: {seen:?}");
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
