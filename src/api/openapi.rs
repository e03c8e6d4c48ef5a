//! The OpenAPI document: what the handlers declare, and what all of them have in common. The schemas of enumerations
//! are in `enum_schemas`, shared parameters and errors in `parameters` and `problem_responses`.

use serde_json::Value;
use utoipa::OpenApi;

use super::access::add_security;
use super::entity_tags::document_tags;
use super::paging::document_links;
use super::problem::{FieldError, ProblemBody};
use super::webhooks::add_calls;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "mapshift",
        description = "Reports to the maintainers of a map where the world has changed.\n\nVehicles upload batches of 2D lidar scans; the service keeps one pose graph per route and raises alerts where new observations contradict it. Units are metres, radians and seconds; x points forward, y left, angles are counter-clockwise (REP-103); times are in UTC (RFC 3339). Errors are problem details (RFC 9457); the `type` of each refers to a page that explains it, and `/problems` lists them. Lists are read in pages: `next_cursor` and the header `Link` lead to the next one.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    servers((url = "/", description = "This service")),
    tags(
        (name = "routes", description = "A route has one map and one pose graph"),
        (name = "batches", description = "Uploads of scans or edges"),
        (name = "graph", description = "Nodes, edges, trajectories"),
        (name = "vehicles", description = "Vehicles, their trips and their calibration"),
        (name = "residuals", description = "The statistics of loop-closure residuals"),
        (name = "alerts", description = "Where the world has changed, and decisions about it"),
        (name = "webhooks", description = "Receivers to which events are POSTed. Calls are signed according to Standard Webhooks; the key is the bytes whose base64 follows `whsec_` in the secret"),
        (name = "map", description = "Pictures and versions of the map"),
        (name = "audit", description = "Who changed what, when, and from where"),
        (name = "access", description = "Keys, and sessions of people who have signed in"),
        (name = "operations", description = "For the operators of the service")
    ),
    components(schemas(ProblemBody, FieldError))
)]
pub(super) struct Document;

/// The document with everything that handlers do not declare: the calls that webhooks make, the roles that operations
/// need, and which answers have an ETag.
///
/// # Errors
/// If the document does not serialise.
pub(super) fn complete(document: &utoipa::openapi::OpenApi) -> Result<Value, serde_json::Error> {
    let mut document = serde_json::to_value(document)?;
    add_calls(&mut document);
    add_security(&mut document);
    document_tags(&mut document);
    document_links(&mut document);
    document_bodies(&mut document);
    Ok(document)
}

/// Makes bodies without a required field optional: no body counts as `{}`.
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
mod tests;
