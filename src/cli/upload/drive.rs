//! Uploads a recording in batches of scans.

use std::path::Path;

use anyhow::Context;

use super::args::Args;
use super::tally::{Tally, advice};
use crate::cli::progress::{Progress, say};
use crate::cli::recording;
use crate::client::{EncodedBatch, Gateway, GatewayError, Outcome, rough};
use crate::ids::StampNs;
use crate::ingest::{BatchHead, BatchWriter};
use crate::model::BatchKind;

/// A recording ready to be sent; only the compressed batches of its scans are in memory.
pub(super) struct PreparedTrip {
    /// Description of its contents, for people.
    about: Vec<String>,
    /// The batches with the number of scans in each.
    batches: Vec<(EncodedBatch, usize)>,
}

impl PreparedTrip {
    /// Reads a recording to its end.
    ///
    /// # Errors
    /// If it cannot be read to its end, or none of its scans can be used.
    pub(super) fn of(args: &Args, path: &Path) -> anyhow::Result<Self> {
        let trip_id = args.trip_of(path)?;
        let file = recording::open(path, &args.topics())?.with_beam_spacing(args.beam_spacing);
        let head = BatchHead {
            vehicle_id: &args.vehicle,
            trip_id: &trip_id,
            initial_pose: args.initial_pose.map(rough),
            lidars: &file.recording.lidars,
        };
        let scans = file.recording.scans(file.reader()?)?;
        let mut writer = BatchWriter::new(head, scans, args.batch_scans.into());
        let mut batches = Vec::new();
        let mut stamps: Option<[StampNs; 2]> = None;
        for written in writer.by_ref() {
            let written = written.with_context(|| path.display().to_string())?;
            let [first, last] = written.stamps;
            stamps = Some([stamps.map_or(first, |[begin, _]| begin), last]);
            let (sequence, json) = (written.sequence, &written.json);
            let batch = EncodedBatch::of_json(BatchKind::Scans, &trip_id, sequence, json)?;
            batches.push((batch, written.scans));
        }
        let scans = writer.scans();
        let Some(stamps) = stamps else {
            return Err(scans.none_usable()).with_context(|| path.display().to_string());
        };
        let count = batches.iter().map(|(_, scans)| scans).sum();
        Ok(Self {
            about: file.describe(count, stamps, scans),
            batches,
        })
    }
}

/// Sends a recording in batches of scans.
///
/// # Errors
/// If a batch could not be sent; a refusal is noted in the tally.
pub(super) async fn upload(
    gateway: &Gateway,
    args: &Args,
    path: &Path,
    trip: PreparedTrip,
    tally: &mut Tally,
) -> anyhow::Result<()> {
    trip.about.iter().for_each(|line| say(line));
    tally.ensure_route(gateway, &args.route).await?;
    let mut left: usize = trip.batches.iter().map(|(_, scans)| scans).sum();
    let progress = Progress::new(left as u64, "scans");
    let gateway = gateway.notifying(progress.speaker());
    for (batch, scans) in trip.batches {
        match gateway.put_batch(&args.route, &batch).await {
            Ok(Outcome::Stored) => {
                tally.stored += 1;
                tally.scans_stored += scans;
            }
            Ok(Outcome::Replayed) => tally.replayed += 1,
            Err(error @ GatewayError::Refused { .. }) => {
                tally.failures.push(format!(
                    "{}: {error}{}; its last {left} scans are not stored",
                    path.display(),
                    advice(&error),
                ));
                break;
            }
            Err(error) => return Err(error.into()),
        }
        tally.batches.push(batch.id);
        progress.advance(scans as u64);
        left -= scans;
    }
    progress.finish();
    Ok(())
}
