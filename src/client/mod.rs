//! An HTTP client of the service: repeatable uploads of scans and graphs, and queries about them.
//!
//! Knows the API's JSON; must not know the inside of the service. Begin with [`Gateway::put_batch`].

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
