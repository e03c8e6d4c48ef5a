//! Recordings: a whole trip as one file, which becomes batches of scans.

use std::fs::File;
use std::io::{BufReader, Seek};

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
use super::batches::{BatchBody, count_upload, out_of_range, upload_answer};
use super::client_address::ClientAddress;
use super::extract::{ApiPath, ApiQuery};
use super::maps::Binary;
use super::parameters::{BatchParam, RecordingHeaders, RouteParam};
use super::problem::{Problem, ProblemKind};
use super::problem_responses::RecordingUploadProblems;
use super::upload::receive_recording;
use crate::ids::{BatchId, NAME_LENGTH_MAX, RouteId, TripId, VehicleId};
use crate::ingest::mcap::{McapError, MountOverride, TopicChoice};
use crate::ingest::{
    BatchHead, BatchWriter, CarmenError, Recording, RecordingError, WriteError, WrittenBatch,
    batch_json,
};
use crate::model::RecordingFormat;
use crate::store::{BatchContent, Journaled, NewBatch, RecordedBatches, RecordingJournaled};

/// Scans of a batch that a recording is written into.
const PART_SCANS: usize = 300;
/// Most batches of a recording: their numbers have four digits.
const PARTS_MAX: usize = 10_000;
/// Characters that the names of all batches but the last have more than the recording's.
const SUFFIX_LENGTH: usize = 5;
/// Most beams of a recording: some hours of a lidar.
const BEAMS_MAX: usize = 100_000_000;
/// Longest CARMEN log, bytes: it is held in memory, where its numbers are longer.
const CARMEN_BYTES_MAX: u64 = 32 << 20;

/// What a recording is. As JSON it is part of the recording's identity: what is left out is not written, so
/// that another parameter changes nothing of the recordings without it.
#[derive(Debug, Clone, Deserialize, Serialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct RecordingQuery {
    /// Who drove.
    #[param(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    vehicle_id: String,
    /// Which drive: the recording is all of it.
    #[param(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    trip_id: String,
    /// How it is written.
    #[param(inline)]
    format: RecordingFormat,
    /// Topics of the lidars' scans in an MCAP recording, separated by commas, the one that takes
    /// keyframes first; all topics with scans if left out.
    #[param(nullable = false, example = "/front/scan,/rear/scan")]
    #[serde(skip_serializing_if = "Option::is_none")]
    topic: Option<String>,
    /// Topic of the odometry in an MCAP recording, or of the transforms that hold it; the only one if
    /// left out, else the transforms from odom to the vehicle.
    #[param(nullable = false, example = "/odom")]
    #[serde(skip_serializing_if = "Option::is_none")]
    odometry_topic: Option<String>,
    /// Where the lidar is mounted, in place of what the recording says: metres ahead of the base.
    #[param(nullable = false, minimum = -50, maximum = 50)]
    #[serde(skip_serializing_if = "Option::is_none")]
    mount_x: Option<f64>,
    /// Metres to the left of the base.
    #[param(nullable = false, minimum = -50, maximum = 50)]
    #[serde(skip_serializing_if = "Option::is_none")]
    mount_y: Option<f64>,
    /// Its heading on the base, radians, counter-clockwise.
    #[param(nullable = false)]
    #[serde(skip_serializing_if = "Option::is_none")]
    mount_theta: Option<f64>,
}

/// Upload a recording.
///
/// A whole trip as one file: an MCAP recording (ROS 2 `sensor_msgs/msg/LaserScan` with
/// `nav_msgs/msg/Odometry` or `/tf`, and `/tf_static` for the lidar's mount; or Foxglove's JSON messages), or
/// a CARMEN log. It is stored as batches of 300 scans, all of them or none: the last one has the
/// recording's name, those before it that name with `.0000`, `.0001`, … behind it. Safe to repeat: the same
/// bytes with the same parameters are stored once. Scans outside of the odometry's time are left out.
#[utoipa::path(
    put, path = "/v1/routes/{route}/recordings/{batch}", tag = "batches",
    params(RouteParam, BatchParam, RecordingQuery, RecordingHeaders),
    request_body(
        content = Binary, content_type = "application/octet-stream",
        description = "The file, not compressed by the sender: at most 256 MiB; a CARMEN log at most 32 MiB"
    ),
    responses(
        (status = 200, description = "The same recording was stored before", body = BatchBody, headers(("Idempotent-Replayed" = String, description = "`true`"))),
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
    let about = About::of(&query, route_id, id).map_err(Problem::closing)?;
    identity
        .check_upload(&about.vehicle_id)
        .map_err(Problem::closing)?;
    let outcome = store_recording(&state, client, about.clone(), &query, &headers, body).await;
    count_upload(outcome.as_ref().copied());
    let journaled = outcome?;
    let batch = state.store.batch(&about.route_id, &about.id).await?;
    // The route may have been deleted since.
    let batch = batch.ok_or_else(Problem::unknown_route)?;
    upload_answer(&state, journaled, batch).await
}

/// The checked names and choices of a recording.
#[derive(Debug, Clone)]
struct About {
    route_id: RouteId,
    id: BatchId,
    vehicle_id: VehicleId,
    trip_id: TripId,
    format: RecordingFormat,
    choice: TopicChoice,
}

impl About {
    fn of(query: &RecordingQuery, route_id: RouteId, id: BatchId) -> Result<Self, Problem> {
        let length_max = NAME_LENGTH_MAX - SUFFIX_LENGTH;
        if id.as_str().len() > length_max {
            let detail = format!(
                "a recording's name has at most {length_max} characters: those of its batches are longer"
            );
            return Err(Problem::new(ProblemKind::InvalidField, detail).at("batch"));
        }
        let vehicle_id = VehicleId::new(query.vehicle_id.as_str());
        let trip_id = TripId::new(query.trip_id.as_str());
        let finite = |name: &str, value: Option<f64>| match value {
            Some(value) if !value.is_finite() => {
                Err(Problem::parameter(name, "it must be a number, like 0.25"))
            }
            value => Ok(value),
        };
        let topics = query.topic.iter().flat_map(|topics| topics.split(','));
        Ok(Self {
            route_id,
            id,
            vehicle_id: vehicle_id
                .map_err(|error| Problem::parameter("vehicle_id", error.to_string()))?,
            trip_id: trip_id.map_err(|error| Problem::parameter("trip_id", error.to_string()))?,
            format: query.format,
            choice: TopicChoice {
                lidars: topics.map(str::to_owned).collect(),
                odometry: query.odometry_topic.clone(),
                mount: MountOverride {
                    x: finite("mount_x", query.mount_x)?,
                    y: finite("mount_y", query.mount_y)?,
                    theta: finite("mount_theta", query.mount_theta)?,
                },
            },
        })
    }
}

/// Reads the body onto the disk, writes it as batches, and stores them.
async fn store_recording(
    state: &ApiState,
    client: ClientAddress,
    about: About,
    query: &RecordingQuery,
    headers: &HeaderMap,
    body: Body,
) -> Result<Journaled, Problem> {
    let route = state.known_route(&about.route_id).await;
    route.map_err(Problem::closing)?;
    let received = receive_recording(state, client, headers, body).await?;
    if about.format == RecordingFormat::Carmen && received.bytes > CARMEN_BYTES_MAX {
        let detail = format!(
            "a CARMEN log has at most {CARMEN_BYTES_MAX} bytes: send it in parts, as several trips"
        );
        return Err(Problem::new(ProblemKind::TooLarge, detail));
    }
    let parameters = serde_json::to_vec(query).map_err(Problem::internal)?;
    let identity = Sha256::new()
        .chain_update(received.sha256)
        .chain_update(parameters);
    let identity = identity.finalize().into();
    let (route_id, id) = (about.route_id.clone(), about.id.clone());
    if let Some(found) = state.store.recording(&route_id, &id, &identity).await? {
        return journaled(found);
    }
    let received_at = Timestamp::now();
    let (file, places) = (received.file, received.places);
    let batches_max = state.limits.recording_bytes;
    let batches = state
        .transcoding
        .run(move || about.batches(file, received_at, batches_max));
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
            "this route has a batch of this name, or of one of its parts, that is not this recording with these parameters: choose another name",
        ),
        RecordingJournaled::TripTaken => (
            ProblemKind::TripTaken,
            "a recording is a whole trip, and this route has batches of a trip of this name: choose another trip_id",
        ),
    };
    Err(Problem::new(kind, detail))
}

impl About {
    /// The recording as batches.
    fn batches(
        &self,
        mut file: File,
        received_at: Timestamp,
        bytes_max: usize,
    ) -> Result<RecordedBatches, Problem> {
        file.rewind().map_err(Problem::internal)?;
        let recording = Recording::open(BufReader::new(&file), self.format, &self.choice)?;
        (&file).rewind().map_err(Problem::internal)?;
        let head = BatchHead {
            vehicle_id: &self.vehicle_id,
            trip_id: &self.trip_id,
            initial_pose: None,
            lidars: &recording.lidars,
        };
        let scans = recording.scans(BufReader::new(&file))?;
        let mut writer = BatchWriter::new(head, scans, PART_SCANS);
        let beams = recording.lidars.iter().map(|lidar| lidar.beams).max();
        let scans_max = BEAMS_MAX / beams.unwrap_or(1).max(1);
        let (mut batches, mut scans) = (RecordedBatches::default(), 0);
        for written in writer.by_ref() {
            let written = written?;
            scans += written.scans;
            let is_too_much =
                written.sequence >= PARTS_MAX || batches.compressed_bytes() > bytes_max;
            if is_too_much || scans > scans_max {
                let detail = "the recording has more scans than one trip may have: cut it into several recordings";
                return Err(Problem::new(ProblemKind::TooLarge, detail));
            }
            batches.push(self.batch(written, received_at)?)?;
        }
        match batches.last_mut() {
            Some(last) => last.id = self.id.clone(),
            None => return Err(writer.scans().none_usable().into()),
        }
        Ok(batches)
    }

    fn batch(&self, written: WrittenBatch, received_at: Timestamp) -> Result<NewBatch, Problem> {
        // As the worker will read it: what it would refuse is refused now.
        let batch = batch_json::decode(&written.json, received_at)?;
        batch.ranges.check_units()?;
        let id = BatchId::new(format!("{}.{:04}", self.id, written.sequence));
        Ok(NewBatch {
            route_id: self.route_id.clone(),
            id: id.map_err(Problem::internal)?,
            vehicle_id: batch.vehicle_id,
            trip_id: batch.trip_id,
            content: BatchContent::Scans {
                sequence: batch.sequence,
                scans: batch.scans.len() as i64,
            },
            flags: batch.flags,
            out_of_range: Some(out_of_range(&batch.ranges)),
            extensions: None,
            body: written.json,
            received_at,
        })
    }
}

impl From<RecordingError> for Problem {
    fn from(error: RecordingError) -> Self {
        let kind = match &error {
            RecordingError::Mcap(McapError::Io(_)) | RecordingError::Carmen(CarmenError::Io(_)) => {
                return Self::internal(error);
            }
            RecordingError::Mcap(McapError::Topics { .. }) | RecordingError::NoTopics => {
                ProblemKind::RecordingTopics
            }
            RecordingError::Mcap(
                McapError::ChunkTooLarge { .. }
                | McapError::TooMuchOdometry(_)
                | McapError::TooManyTopics(_),
            ) => ProblemKind::TooLarge,
            _ => ProblemKind::Recording,
        };
        Self::new(kind, chain(&error))
    }
}

impl From<WriteError> for Problem {
    fn from(error: WriteError) -> Self {
        match error {
            WriteError::Recording(error) => error.into(),
            WriteError::Stamp(_) => Self::new(ProblemKind::Recording, chain(&error)),
            WriteError::Json(_) => Self::internal(error),
        }
    }
}

/// An error with its causes: they are about the sender's file.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
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
