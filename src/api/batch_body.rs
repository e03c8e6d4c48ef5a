//! A batch as clients see it.

use jiff::Timestamp;
use serde::Serialize;
use serde_json::value::RawValue;
use utoipa::ToSchema;

use super::batch_upload::extensions_schema;
use crate::ids::AlertId;
use crate::model::{BatchKind, BatchStatus};
use crate::store::{BatchRecord, OutOfRange};

/// An upload and its status.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Batch)]
pub(super) struct BatchBody {
    /// Chosen by the client.
    #[schema(example = "b-000123")]
    pub id: String,
    /// The route.
    pub route_id: String,
    /// The vehicle.
    pub vehicle_id: String,
    /// The trip.
    trip_id: String,
    /// What it contains.
    kind: BatchKind,
    /// 0, 1, 2 … within the trip; batches of edges are numbered in the order of arrival.
    sequence: i64,
    /// How far it has been processed.
    status: BatchStatus,
    /// Why it has this status, for people.
    #[schema(required)]
    reason: Option<String>,
    /// Peculiarities: `above_range_max` (readings that count as no return), `below_range_min` (invalid readings),
    /// `clock_skew` (its clock is more than a day ahead; a trip that begins more than a week ahead is dated from its
    /// arrival, in the graph and in alerts), `clockwise_scans` (their beams were put into counter-clockwise order),
    /// `empty_scans`, `gap` (batches before it never arrived), `late`, `map_mended` (it led to the correction of a
    /// segment of the map, which a resolved `map_mismatch` describes), `not_localised` (the vehicle's place was
    /// unknown at its end), `simulated_time` (stamps before 2000: the trip is dated from its arrival),
    /// `wild_odometry`, …
    flags: Vec<String>,
    /// Readings outside the range of their lidar; null for edges, and for batches that arrived before the service
    /// counted them.
    #[schema(required)]
    out_of_range: Option<OutOfRangeBody>,
    /// As it was sent; null if none was sent, or if the batch was erased.
    #[schema(required, schema_with = extensions_schema)]
    extensions: Option<Box<RawValue>>,
    /// The number of scans.
    scans: i64,
    /// Nodes that it added to the graph.
    nodes_added: i64,
    /// Loop closures that it added to the graph.
    loop_closures: i64,
    /// Ids of the alerts that rest on it.
    alerts: Vec<String>,
    /// When it arrived.
    #[schema(value_type = String, format = DateTime)]
    received_at: Timestamp,
    /// When it was last processed; null before.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    processed_at: Option<Timestamp>,
}

/// Readings of a batch outside the range of their lidar.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = OutOfRangeReadings)]
struct OutOfRangeBody {
    /// Readings of `range_max` or more: they count as no return, like null.
    above_range_max: i64,
    /// Readings below `range_min`, including 0 and less: invalid, they show neither an object nor free space.
    below_range_min: i64,
}

impl From<OutOfRange> for OutOfRangeBody {
    fn from(readings: OutOfRange) -> Self {
        Self {
            above_range_max: readings.above_range_max,
            below_range_min: readings.below_range_min,
        }
    }
}

impl BatchBody {
    /// # Errors
    /// If the stored extensions are not JSON.
    pub(super) fn new(batch: BatchRecord, alerts: &[AlertId]) -> Result<Self, serde_json::Error> {
        let extensions = batch.extensions.map(RawValue::from_string).transpose()?;
        Ok(Self {
            id: batch.id.to_string(),
            route_id: batch.route_id.to_string(),
            vehicle_id: batch.vehicle_id.to_string(),
            trip_id: batch.trip_id.to_string(),
            kind: batch.kind,
            sequence: batch.sequence,
            status: batch.status,
            reason: batch.reason,
            flags: batch.flags,
            out_of_range: batch.out_of_range.map(OutOfRangeBody::from),
            extensions,
            scans: batch.scans,
            nodes_added: batch.nodes_added,
            loop_closures: batch.loop_closures,
            alerts: alerts.iter().map(ToString::to_string).collect(),
            received_at: batch.received_at,
            processed_at: batch.processed_at,
        })
    }
}
