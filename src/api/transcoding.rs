//! A recording written as batches of scans.

use std::fs::File;
use std::io::{BufReader, Seek};

use jiff::Timestamp;

use super::batch_intake::out_of_range;
use super::problem::{Problem, ProblemKind};
use crate::ids::{BatchId, RouteId, TripId, VehicleId};
use crate::ingest::mcap::{McapError, TopicChoice};
use crate::ingest::{
    BatchHead, BatchWriter, CarmenError, Recording, RecordingError, WriteError, WrittenBatch,
    batch_json,
};
use crate::model::RecordingFormat;
use crate::store::{BatchContent, NewBatch, RecordedBatches};

/// Scans of each batch but the last.
const BATCH_SCANS: usize = 300;
/// Most batches of a recording: their numbers have four digits.
const BATCHES_MAX: usize = 10_000;
/// Most beams of a recording: some hours of a lidar.
const BEAMS_MAX: usize = 100_000_000;

/// The checked names and choices of a recording.
#[derive(Debug, Clone)]
pub(super) struct RecordingSpec {
    pub(super) route_id: RouteId,
    pub(super) id: BatchId,
    pub(super) vehicle_id: VehicleId,
    pub(super) trip_id: TripId,
    pub(super) format: RecordingFormat,
    pub(super) choice: TopicChoice,
}

impl RecordingSpec {
    /// The recording as batches, of at most `bytes_max` bytes compressed.
    ///
    /// # Errors
    /// 413 for a recording that is too long; 422 for one that cannot be used.
    pub(super) fn batches(
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
        let mut writer = BatchWriter::new(head, scans, BATCH_SCANS);
        let beams = recording.lidars.iter().map(|lidar| lidar.beams).max();
        let scans_max = BEAMS_MAX / beams.unwrap_or(1).max(1);
        let (mut batches, mut scans) = (RecordedBatches::default(), 0);
        for written in writer.by_ref() {
            let written = written?;
            scans += written.scans;
            let is_too_much =
                written.sequence >= BATCHES_MAX || batches.compressed_bytes() > bytes_max;
            if is_too_much || scans > scans_max {
                let detail = "the recording has more scans than one trip may have: split it into several recordings";
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
        // Decoded as the worker will do it, so that what the worker would refuse is refused now.
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

/// An error with its causes, which are about the sender's file.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}
