//! A job of which nothing is taken into the map.

use super::engine::Engine;
use super::result::{Added, Origin, kept_out, of_added};
use super::workspace::Workspace;
use crate::ids::VehicleId;
use crate::model::BatchStatus;
use crate::store::{BatchOutcome, ClaimedJob, JobResult, Quarantine};

/// What came of a job.
pub(super) enum Processed {
    /// The map, and what is to be saved.
    Taken(Box<(Workspace, JobResult)>),
    /// Nothing: the map stays as it was.
    Refused(Refusal),
}

/// What becomes of the batches of a job that changes nothing.
pub(super) struct Refusal {
    pub origins: Vec<Origin>,
    pub outcomes: Vec<BatchOutcome>,
}

/// What becomes of the batches of a job, all of them of one vehicle, which somebody keeps out of the map.
pub(super) fn of_quarantine(
    job: &ClaimedJob,
    vehicle: &VehicleId,
    quarantine: &Quarantine,
) -> Refusal {
    let note = quarantine.note.as_deref().unwrap_or("no reason was given");
    let origins = job.entries.iter().map(|entry| Origin::of(&entry.batch));
    let origins: Vec<Origin> = origins.collect();
    let reason = format!("vehicle {vehicle} is kept out of the map: {note}");
    Refusal {
        outcomes: kept_out(&origins, BatchStatus::Quarantined, &reason),
        origins,
    }
}

/// The result of a refused job, on the map as it is stored: the one in memory was tried on.
///
/// # Errors
/// If the map cannot be loaded.
pub(super) async fn refuse(
    engine: &Engine,
    job: &ClaimedJob,
    refusal: Refusal,
) -> anyhow::Result<(Workspace, JobResult)> {
    let mut workspace = engine.workspaces.take(&engine.store, &job.route_id).await?;
    let mut result = of_added(&mut workspace, job, &refusal.origins, &Added::default())?;
    result.outcomes = refusal.outcomes;
    Ok((workspace, result))
}
