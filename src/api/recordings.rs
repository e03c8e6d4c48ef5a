//! Recordings: a whole trip as one file, which is stored as batches of scans.

use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use utoipa::IntoParams;

use super::ApiState;
use super::access::Identity;
use super::batch_body::BatchBody;
use super::batch_intake::{count_upload, upload_answer};
use super::client_address::ClientAddress;
use super::extract::{ApiPath, ApiQuery};
use super::parameters::{BatchParam, RecordingHeaders, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RecordingUploadProblems;
use super::transcoding::RecordingSpec;
use super::types::Binary;
use super::upload::receive_recording;
use crate::ids::{BatchId, NAME_LENGTH_MAX, RouteId, TripId, VehicleId};
use crate::ingest::mcap::{MountOverride, TopicChoice};
use crate::model::RecordingFormat;
use crate::store::{Journaled, RecordingJournaled};

/// By how much the names of all batches but the last are longer than the recording's.
const SUFFIX_LENGTH: usize = 5;
/// Longest CARMEN log, bytes: it is held in memory, where its numbers take more space.
const CARMEN_BYTES_MAX: u64 = 32 << 20;

/// How to read a recording. As JSON this is part of the recording's identity: parameters that are left out are not
/// written, so that a new parameter does not change the identity of recordings without it.
#[derive(Debug, Clone, Deserialize, Serialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct RecordingQuery {
    /// The vehicle.
    #[param(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: String,
    /// The trip, all of which is in the recording.
    #[param(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    trip_id: String,
    /// The format of the file.
    #[param(inline)]
    format: RecordingFormat,
    /// Topics of the lidars' scans in an MCAP recording, separated by commas, the one that takes keyframes first; all
    /// topics with scans by default.
    #[param(nullable = false, example = "/front/scan,/rear/scan")]
    #[serde(skip_serializing_if = "Option::is_none")]
    topic: Option<String>,
    /// Topic of the odometry in an MCAP recording, or of the transforms that contain it. By default the only odometry
    /// topic, or without one the transforms from odom to the vehicle.
    #[param(nullable = false, example = "/odom")]
    #[serde(skip_serializing_if = "Option::is_none")]
    odometry_topic: Option<String>,
    /// The lidar's mount, overriding the recording: metres ahead of the base.
    #[param(nullable = false, minimum = -50, maximum = 50)]
    #[serde(skip_serializing_if = "Option::is_none")]
    mount_x: Option<f64>,
    /// The lidar's mount: metres to the left of the base.
    #[param(nullable = false, minimum = -50, maximum = 50)]
    #[serde(skip_serializing_if = "Option::is_none")]
    mount_y: Option<f64>,
    /// The lidar's mount: heading against the base, radians, counter-clockwise.
    #[param(nullable = false)]
    #[serde(skip_serializing_if = "Option::is_none")]
    mount_theta: Option<f64>,
}

/// Upload a recording.
///
/// A whole trip as one file: an MCAP recording (ROS 2 `sensor_msgs/msg/LaserScan` with `nav_msgs/msg/Odometry` or
/// `/tf`, and `/tf_static` for the lidar's mount; or Foxglove's JSON messages), or a CARMEN log. It is stored as
/// batches of 300 scans, either all or none: the last one has the recording's name, the others that name followed
/// by `.0000`, `.0001`, …. Safe to repeat: the same bytes with the same parameters are stored once. Scans outside
/// the time span of the odometry are left out.
#[utoipa::path(
    put, path = "/v1/routes/{route}/recordings/{batch}", tag = "batches",
    params(RouteParam, BatchParam, RecordingQuery, RecordingHeaders),
    request_body(
        content = Binary, content_type = "application/octet-stream",
        description = "The file, uncompressed: at most 256 MiB, a CARMEN log at most 32 MiB"
    ),
    responses(
        (status = 200, description = "The same recording has been stored before", body = BatchBody, headers(("Idempotent-Replayed" = String, description = "`true`"))),
        (status = 202, description = "Stored durably", body = BatchBody, headers(("Location" = String, description = "The recording's last batch"))),
        RecordingUploadProblems,
    )
)]
pub(super) async fn put_recording(
    State(state): State<ApiState>,
    client: ClientAddress,
    identity: Identity,
    ApiPath((route_id, id)): ApiPath<(RouteId, BatchId)>,
    ApiQuery(query): ApiQuery<RecordingQuery>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let spec = query.check(route_id, id).map_err(Problem::closing)?;
    identity
        .check_upload(&spec.vehicle_id)
        .map_err(Problem::closing)?;
    let outcome = store_recording(&state, client, spec.clone(), &query, &headers, body).await;
    count_upload(outcome.as_ref().copied());
    let journaled = outcome?;
    let batch = state.store.batch(&spec.route_id, &spec.id).await?;
    // The route may have been deleted in the meantime.
    let batch = batch.ok_or_else(Problem::unknown_route)?;
    upload_answer(&state, journaled, batch).await
}

impl RecordingQuery {
    /// The recording's names and choices, checked.
    ///
    /// # Errors
    /// 400 for a name or a number that is not usable.
    fn check(&self, route_id: RouteId, id: BatchId) -> Result<RecordingSpec, Problem> {
        let length_max = NAME_LENGTH_MAX - SUFFIX_LENGTH;
        if id.as_str().len() > length_max {
            let detail = format!(
                "a recording's name has at most {length_max} characters, because those of its batches are longer"
            );
            return Err(Problem::new(ProblemKind::InvalidField, detail).at("batch"));
        }
        let vehicle_id = VehicleId::new(self.vehicle_id.as_str());
        let trip_id = TripId::new(self.trip_id.as_str());
        let finite = |name: &str, value: Option<f64>| match value {
            Some(value) if !value.is_finite() => Err(Problem::parameter(
                name,
                "send a finite number, such as 0.25",
            )),
            value => Ok(value),
        };
        let topics = self.topic.iter().flat_map(|topics| topics.split(','));
        Ok(RecordingSpec {
            route_id,
            id,
            vehicle_id: vehicle_id
                .map_err(|error| Problem::parameter("vehicle_id", error.to_string()))?,
            trip_id: trip_id.map_err(|error| Problem::parameter("trip_id", error.to_string()))?,
            format: self.format,
            choice: TopicChoice {
                lidars: topics.map(str::to_owned).collect(),
                odometry: self.odometry_topic.clone(),
                mount: MountOverride {
                    x: finite("mount_x", self.mount_x)?,
                    y: finite("mount_y", self.mount_y)?,
                    theta: finite("mount_theta", self.mount_theta)?,
                },
            },
        })
    }
}

/// Reads the body into a file, converts it to batches, and stores them.
async fn store_recording(
    state: &ApiState,
    client: ClientAddress,
    spec: RecordingSpec,
    query: &RecordingQuery,
    headers: &HeaderMap,
    body: Body,
) -> Result<Journaled, Problem> {
    let route = state.known_route(&spec.route_id).await;
    route.map_err(Problem::closing)?;
    let received = receive_recording(state, client, headers, body).await?;
    if spec.format == RecordingFormat::Carmen && received.bytes > CARMEN_BYTES_MAX {
        let detail = format!(
            "a CARMEN log has at most {CARMEN_BYTES_MAX} bytes: split it into several trips"
        );
        return Err(Problem::new(ProblemKind::TooLarge, detail));
    }
    let parameters = serde_json::to_vec(query).map_err(Problem::internal)?;
    let identity = Sha256::new()
        .chain_update(received.sha256)
        .chain_update(parameters);
    let identity = identity.finalize().into();
    let (route_id, id) = (spec.route_id.clone(), spec.id.clone());
    if let Some(found) = state.store.recording(&route_id, &id, &identity).await? {
        return journaled(found);
    }
    let received_at = Timestamp::now();
    let (file, places) = (received.file, received.places);
    let batches_max = state.limits.recording_bytes;
    let batches = state
        .transcoding
        .run(move || spec.batches(file, received_at, batches_max));
    let batches = batches.await??;
    let outcome = state.store.journal_recording(batches, identity).await?;
    drop(places);
    journaled(outcome)
}

fn journaled(outcome: RecordingJournaled) -> Result<Journaled, Problem> {
    let (kind, detail) = match outcome {
        RecordingJournaled::Stored => return Ok(Journaled::Stored),
        RecordingJournaled::Replayed => return Ok(Journaled::Replayed),
        RecordingJournaled::Conflict => (
            ProblemKind::BatchIdReused,
            "this route has another batch, or another recording, with this name: choose a different name",
        ),
        RecordingJournaled::TripTaken => (
            ProblemKind::TripTaken,
            "a recording is a whole trip, and this route already has batches of a trip with this name: choose another trip_id",
        ),
    };
    Err(Problem::new(kind, detail))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_is_left_out_is_no_part_of_the_identity() {
        let query = RecordingQuery {
            vehicle_id: "agv-07".into(),
            trip_id: "monday".into(),
            format: RecordingFormat::Mcap,
            topic: None,
            odometry_topic: None,
            mount_x: Some(0.25),
            mount_y: None,
            mount_theta: None,
        };
        let expected =
            json!({"vehicle_id": "agv-07", "trip_id": "monday", "format": "mcap", "mount_x": 0.25});
        assert_eq!(serde_json::to_value(&query).unwrap(), expected);
    }
}
