//! One job, from its bodies to what is to be saved: the computation, without any waiting.

use anyhow::Context;

use super::alerts::fold_into;
use super::findings::findings;
use super::result::{self, Origin};
use super::stage::stage_of;
use super::workspace::Workspace;
use crate::formats::batch_json;
use crate::mapping::{Drive, DriveScan, Extension, NotExtended};
use crate::store::{BatchOutcome, BatchStatus, ClaimedJob, JobResult};

/// No vehicle drives this far between two scans, metres.
const JUMP_MAX_M: f64 = 100.0;

/// Takes the job's batches through the map.
///
/// # Errors
/// If a journalled body cannot be decoded, or the graph refuses an id; the workspace is lost
/// then.
pub(super) fn process(
    mut workspace: Workspace,
    job: &ClaimedJob,
) -> anyhow::Result<(Workspace, JobResult)> {
    let origins = decode(job)?;
    if let Some(outcome) = origins.last().and_then(refuse_jump) {
        let mut result =
            result::of_extension(&mut workspace, job, &origins, &Extension::default())?;
        result.outcomes = vec![outcome];
        return Ok((workspace, result));
    }
    let drive = join(&origins);
    let first_edge = workspace.map.next_edge_id();
    let (extension, outcomes) = match workspace.map.extend(&drive) {
        Ok(extension) => {
            let outcomes = merged(job, &origins, &extension, &workspace);
            (extension, outcomes)
        }
        Err(NotExtended::Unanchored(reason)) => {
            let reason = reason.to_string();
            let outcomes = job.entries.iter().map(|entry| BatchOutcome {
                batch_id: entry.batch.id.clone(),
                status: BatchStatus::Unanchored,
                reason: Some(reason.clone()),
                flags: Vec::new(),
                nodes_added: 0,
                loop_closures: 0,
            });
            (Extension::default(), outcomes.collect())
        }
        Err(NotExtended::Graph(error)) => return Err(error.into()),
    };
    let mut result = result::of_extension(&mut workspace, job, &origins, &extension)?;
    if !extension.nodes.is_empty() {
        let findings = findings(&workspace, first_edge);
        result.alerts = fold_into(&mut workspace, job, &findings);
    }
    workspace.stage = stage_of(&workspace);
    result.stage = workspace.stage;
    result.outcomes = outcomes;
    Ok((workspace, result))
}

fn decode(job: &ClaimedJob) -> anyhow::Result<Vec<Origin>> {
    let origins = job.entries.iter().map(|entry| {
        let batch = batch_json::decode(&entry.body, entry.batch.received_at)
            .with_context(|| format!("the stored body of batch {} is refused", entry.batch.id))?;
        Ok(Origin {
            batch_id: entry.batch.id.clone(),
            vehicle_id: batch.vehicle_id,
            drive: Drive {
                trip: batch.trip_id,
                initial_pose: batch.initial_pose,
                scans: batch.scans,
            },
        })
    });
    origins.collect()
}

/// Keeps out a batch whose odometry would put its scans where nothing is: the map's pictures and
/// searches would have to span the way there for ever.
fn refuse_jump(origin: &Origin) -> Option<BatchOutcome> {
    let way_m = |pair: &[DriveScan]| {
        let motion = pair[0].odom_from_base.between(&pair[1].odom_from_base);
        motion.translation().norm()
    };
    let longest_m = origin.drive.scans.windows(2).map(way_m).fold(0.0, f64::max);
    (longest_m > JUMP_MAX_M).then(|| BatchOutcome {
        batch_id: origin.batch_id.clone(),
        status: BatchStatus::Quarantined,
        reason: Some(format!(
            "the odometry jumps by {longest_m:.0} m from one scan to the next"
        )),
        flags: Vec::new(),
        nodes_added: 0,
        loop_closures: 0,
    })
}

/// The drives of a trip that waited together, as one.
fn join(origins: &[Origin]) -> Drive {
    let mut joined = origins[0].drive.clone();
    for origin in &origins[1..] {
        joined.scans.extend(origin.drive.scans.iter().cloned());
    }
    joined
}

fn merged(
    job: &ClaimedJob,
    origins: &[Origin],
    extension: &Extension,
    workspace: &Workspace,
) -> Vec<BatchOutcome> {
    let mut outcomes: Vec<BatchOutcome> = origins
        .iter()
        .map(|origin| BatchOutcome {
            batch_id: origin.batch_id.clone(),
            status: BatchStatus::Merged,
            reason: None,
            flags: Vec::new(),
            nodes_added: 0,
            loop_closures: 0,
        })
        .collect();
    if job.after_gap {
        outcomes[0].flags.push("gap".to_owned());
    }
    for node in &extension.nodes {
        outcomes[result::origin_of(origins, &workspace.map, *node)].nodes_added += 1;
    }
    for closure in &extension.closures {
        let edge = workspace.map.graph().edge(closure.edge);
        if let Some(edge) = edge {
            outcomes[result::origin_of(origins, &workspace.map, edge.to)].loop_closures += 1;
        }
    }
    outcomes
}
