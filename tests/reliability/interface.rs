//! The committed description of the interface: which operations there are, and what they may answer.

use serde_json::Value;

/// The document.
const TEXT: &str = include_str!("../../openapi/openapi.json");
const METHODS: [&str; 5] = ["get", "put", "post", "patch", "delete"];
/// It does not end.
const STREAM: &str = "/v1/alerts/stream";

/// An operation.
#[derive(Debug)]
pub struct Operation {
    pub method: &'static str,
    /// With names in braces.
    pub path: String,
    /// Names of its parameters in the query.
    pub query: Vec<String>,
    pub statuses: Vec<u16>,
    pub has_body: bool,
}

/// Every operation whose answer has an end.
pub fn operations() -> Vec<Operation> {
    let document: Value = serde_json::from_str(TEXT).unwrap();
    let paths = document["paths"].as_object().unwrap();
    let mut operations = Vec::new();
    for (path, of_path) in paths.iter().filter(|(path, _)| *path != STREAM) {
        for method in METHODS {
            if let Some(operation) = of_path.get(method) {
                operations.push(read(method, path, operation));
            }
        }
    }
    operations
}

fn read(method: &'static str, path: &str, operation: &Value) -> Operation {
    let parameters = operation["parameters"].as_array().cloned();
    let parameters = parameters.unwrap_or_default().into_iter();
    let in_query = parameters.filter(|parameter| parameter["in"] == "query");
    let statuses = operation["responses"].as_object().unwrap().keys();
    Operation {
        method,
        path: path.to_owned(),
        query: in_query
            .map(|p| p["name"].as_str().unwrap().to_owned())
            .collect(),
        statuses: statuses.map(|status| status.parse().unwrap()).collect(),
        has_body: operation.get("requestBody").is_some(),
    }
}
