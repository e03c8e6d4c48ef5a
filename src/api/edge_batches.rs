//! Uploading batches of edges; everything else about them is as for batches of scans.

use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;
use utoipa::openapi::schema::{Object, ObjectBuilder, SchemaType, Type};

use super::ApiState;
use super::access::Identity;
use super::batch_body::BatchBody;
use super::batch_intake::take_upload;
use super::batch_upload::extensions_schema;
use super::client_address::ClientAddress;
use super::extract::{ApiPath, NoQuery};
use super::parameters::{BatchParam, RouteParam, UploadHeaders};
use super::problem::Problem;
use super::problem_responses::EdgeUploadProblems;
use super::types::PoseBody;
use crate::ids::{BatchId, RouteId, TripId};
use crate::ingest::edges_json;
use crate::model::EdgeKind;
use crate::store::{BatchContent, NewBatch};

/// Nodes and edges that a vehicle has measured itself.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = EdgeBatchUpload, example = json!({
    "vehicle_id": "agv-07", "trip_id": "2026-11-20-a",
    "nodes": [{"id": 0, "pose": {"x": 0.0, "y": 0.0, "theta": 0.0}, "stamp": "2026-11-20T06:00:00Z"},
              {"id": 1, "pose": {"x": 1.0, "y": 0.0, "theta": 0.0}}],
    "edges": [{"from": 0, "to": 1, "measurement": {"x": 1.0, "y": 0.0, "theta": 0.0},
               "information": [2500.0, 0.0, 0.0, 2500.0, 0.0, 10000.0], "kind": "odometry"}]
}))]
#[allow(dead_code)]
pub(super) struct EdgeBatchUpload {
    /// The vehicle.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: String,
    /// The trip; the name of the batch by default. A trip has edges or scans, not both.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    trip_id: Option<String>,
    /// New nodes.
    #[schema(max_items = 5000)]
    nodes: Vec<NodeUpload>,
    /// New edges. A batch has at least one node or edge.
    #[schema(max_items = 20000)]
    edges: Vec<EdgeUpload>,
    /// For your own use: stored, and returned with the batch.
    #[schema(schema_with = extensions_schema)]
    extensions: Option<serde_json::Map<String, serde_json::Value>>,
}

/// A new node.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
struct NodeUpload {
    /// The vehicle's own id of the node: a name or an integer (7 and "7" are the same) that it has not used on
    /// this route before.
    #[schema(schema_with = own_name)]
    id: String,
    /// The vehicle's own estimate of the pose. It is used for the first node of an empty map; the initial poses of
    /// all other nodes follow from the edges.
    pose: PoseBody,
    /// RFC 3339, between 1970 and 2100. The arrival of the batch by default, and instead of a time before 2000, which
    /// is taken to be simulated.
    #[schema(format = DateTime)]
    stamp: Option<String>,
}

/// A new edge.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
struct EdgeUpload {
    /// A node of this batch, or of any trip of the vehicle on this route, by the vehicle's own id; or `map:` followed
    /// by the id of any node of the map.
    #[schema(schema_with = any_name)]
    from: String,
    /// Another node, in the same form as `from`.
    #[schema(schema_with = any_name)]
    to: String,
    /// `from_from_to`: the pose of `to` relative to `from`.
    measurement: PoseBody,
    /// Information matrix in the order (x, y, θ), upper triangle row by row, as in g2o; positive definite, no entry
    /// beyond 1e12. A route with detector `seed` uses the identity instead, as the paper does.
    #[schema(min_items = 6, max_items = 6)]
    information: Vec<f64>,
    /// How it was measured.
    kind: EdgeKind,
}

fn own_name() -> Object {
    name("^[A-Za-z0-9._-]{1,64}$")
}

fn any_name() -> Object {
    name("^(map:[0-9]{1,19}|[A-Za-z0-9._-]{1,64})$")
}

fn name(pattern: &str) -> Object {
    ObjectBuilder::new()
        .schema_type(SchemaType::from_iter([Type::String, Type::Integer]))
        .pattern(Some(pattern))
        .build()
}

/// Upload a batch of edges.
///
/// For vehicles that match scans on board or have other sensors. Safe to repeat; answered and processed like a
/// batch of scans, with which it shares the ids. Odometry edges are added first, then loop closures one by one,
/// each with the residual that it leaves.
///
/// Every new node must be connected to the map by a chain of the batch's edges, or in an empty map to the first
/// node of the batch. A batch that names nodes that have not arrived yet, or that is not connected, is
/// `unanchored`: it is tried again with the vehicle's next batch, and when the map has grown. A batch that repeats
/// the id of a node is `quarantined`.
#[utoipa::path(
    put, path = "/v1/routes/{route}/edge-batches/{batch}", tag = "batches",
    params(RouteParam, BatchParam, UploadHeaders),
    request_body(content = EdgeBatchUpload, description = "At most 16 MiB as sent, 64 MiB after decompression, 20 times the compressed size"),
    responses(
        (status = 200, description = "The same bytes have been stored before", body = BatchBody, headers(("Idempotent-Replayed" = String, description = "`true`"))),
        (status = 202, description = "Stored durably", body = BatchBody, headers(("Location" = String, description = "The batch"))),
        EdgeUploadProblems,
    )
)]
pub(super) async fn put_edge_batch(
    State(state): State<ApiState>,
    client: ClientAddress,
    identity: Identity,
    ApiPath((route_id, id)): ApiPath<(RouteId, BatchId)>,
    _: NoQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let (route, batch) = (route_id.clone(), id.clone());
    let decode = move |body: Vec<u8>, received_at| {
        let edges = edges_json::decode(&body, received_at)?;
        identity.check_upload(&edges.vehicle_id)?;
        let own_trip = || TripId::new(id.as_str()).map_err(Problem::internal);
        Ok(NewBatch {
            vehicle_id: edges.vehicle_id,
            trip_id: edges.trip_id.map_or_else(own_trip, Ok)?,
            content: BatchContent::Edges,
            flags: edges.flags,
            out_of_range: None,
            extensions: edges.extensions,
            route_id,
            id,
            body,
            received_at,
        })
    };
    take_upload(&state, client, (route, batch), &headers, body, decode).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::Timestamp;
    use utoipa::PartialSchema;

    #[test]
    fn the_documented_example_is_taken() {
        let schema = serde_json::to_value(EdgeBatchUpload::schema()).unwrap();
        let example = schema
            .get("example")
            .or_else(|| schema.pointer("/examples/0"));
        let body = serde_json::to_vec(example.unwrap()).unwrap();
        let batch = edges_json::decode(&body, Timestamp::now()).unwrap();
        assert_eq!((batch.nodes.len(), batch.edges.len()), (2, 1));
    }
}
