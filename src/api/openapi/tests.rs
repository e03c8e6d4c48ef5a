//! What holds for all operations and schemas of the document.

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

/// Unknown fields are refused, so the document must list all fields of a request's body.
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
