//! The service's own client: uploads of scans and of graphs that may be repeated, and questions after
//! what became of them.
//!
//! Knows the interface's JSON and nothing of what is behind it. Begin with [`Gateway::put_batch`].

mod batch_body;
mod edge_batch_body;
mod gateway;
#[cfg(test)]
pub mod pretend;

pub use batch_body::{EncodedBatch, ScanToSend, Trip, rough};
pub use edge_batch_body::GraphParts;
pub use gateway::{
    AlertDetail, AlertLocation, AlertReport, BatchReport, Gateway, GatewayError, KeyReport,
    KeyRequest, NodeReport, Outcome, RouteReport, ScanReport,
};
