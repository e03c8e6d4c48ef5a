//! A job that leaves the map unchanged.

use super::added::Added;
use super::engine::Engine;
use super::result::{Origin, kept_out, of_added};
use super::workspace::Workspace;
use crate::ids::VehicleId;
use crate::model::BatchStatus;
use crate::store::{BatchOutcome, ClaimedJob, JobResult, Quarantine};

/// The result of computing a job.
pub(super) enum Processed {
    /// The extended map, and what is to be saved.
    Taken(Box<(Workspace, JobResult)>),
    /// The map stays as it was.
    Refused(Refusal),
}

/// The outcomes of a job's batches of which none was merged.
pub(super) struct Refusal {
    pub origins: Vec<Origin>,
    pub outcomes: Vec<BatchOutcome>,
}

impl Refusal {
    /// Quarantines the newest batch alone.
    pub fn of_newest(origins: Vec<Origin>, reason: &str) -> Self {
        let newest = &origins[origins.len() - 1..];
        Self {
            outcomes: kept_out(newest, BatchStatus::Quarantined, reason),
            origins,
        }
    }
}

/// The refusal of a job whose vehicle a maintainer keeps out of the map.
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

/// The result of a refused job, on the map as it is stored: the one in memory was modified.
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
