//! The body of an upload of edges: JSON to checked nodes and edges.

mod raw;
mod uploaded;
mod validate;

use jiff::Timestamp;

use super::body_error::BatchBodyError;
use super::json::{Object, from_json};
pub use uploaded::{
    EDGES_MAX, MAP_PREFIX, NODES_MAX, NodeName, UploadedEdge, UploadedEdges, UploadedNode,
};

/// Reads and checks a batch of edges. The result depends on the body and on `received_at` alone.
///
/// # Errors
/// [`BatchBodyError`] with the first mistake.
pub fn decode(body: &[u8], received_at: Timestamp) -> Result<UploadedEdges, BatchBodyError> {
    let Object(raw): Object<raw::Batch> = from_json(body)?;
    validate::batch(raw, received_at)
}

#[cfg(test)]
mod tests;
