//! One job of scans, from the bodies of its batches to what is to be saved: pure computation, no waiting.

use anyhow::Context;

use super::added::{Added, added_by, added_closure, count_added};
use super::alerts::fold_into;
use super::calibrate::{KeptScans, TripInMap, kept_scans};
use super::clock::began_simulated;
use super::clock_note::note_clock;
use super::findings::{Detected, detect_in_scans, findings as findings_of};
use super::refusal::{Processed, Refusal};
use super::result::{Origin, kept_out, name_vehicles, of_added, outcome_of};
use super::shift::PosesBefore;
use super::stage::stage_of;
use super::trip_start::{Known, clock_fault, correct_stamps, trip_start};
use super::vehicles::corrected;
use super::workspace::Workspace;
use crate::calibration::Corrections;
use crate::ids::{TripId, VehicleId};
use crate::ingest::batch_json;
use crate::mapping::{
    Drive, DriveScan, Extension, Keyframe, Mending, NotExtended, RouteMap, Weighting,
};
use crate::model::{BatchFlag, BatchStatus, Stage};
use crate::store::{BatchOutcome, ClaimedJob, JobResult, TripCalibrationRecord, TripStart};

/// Odometry that moves farther between two scans is wrong, metres.
const JUMP_MAX_M: f64 = 100.0;

/// Processes the job's batches: from their bodies to everything that is to be saved.
///
/// # Errors
/// If a journalled body cannot be decoded, or the graph refuses an id. The workspace is lost then.
pub(super) fn process(
    mut workspace: Workspace,
    job: &ClaimedJob,
    known: &Known,
) -> anyhow::Result<Processed> {
    // 1. Decode the bodies: the job's batch last, those of its trip that were not localised before it.
    let (origins, mut drives) = decode(job)?;
    let newest = origins.last().context("a job without batches")?;
    let (vehicle, received_at) = (newest.vehicle_id.clone(), job.entries[0].batch.received_at);

    // 2. Refuse what must not touch the map: a jump of odometry, a batch that may end the process.
    if let Some(outcome) = refused_alone(job, &origins, &drives)? {
        return Ok(Processed::Refused(Refusal {
            origins,
            outcomes: vec![outcome],
        }));
    }

    // 3. Fix the trip's clock offset and corrections, or read what its first job fixed.
    let mut drive = join(&drives);
    let start = trip_start(&workspace, &vehicle, &drive, received_at, known);

    // 4. Refuse stamps that cannot be ordered with those of the trip.
    if let Some(reason) = clock_fault(&drive, start.clock_ahead_ns, &workspace.map) {
        return Ok(Processed::Refused(Refusal::of_newest(origins, reason)));
    }

    // 5. Correct stamps and scans.
    for drive in drives.iter_mut().chain([&mut drive]) {
        correct_stamps(drive, start.clock_ahead_ns);
    }
    let drive = corrected(drive, &start.corrections);

    // 6. Extend the map: keyframes, odometry, global localisation, loop closures and their solves.
    let kept = kept_scans(&workspace.map, &drive.trip);
    let guarded = guarded(&workspace, &drive.trip);
    let extended = workspace.map.extend(&drive);

    // 7. Refuse the job if it has moved what others have mapped farther than the route allows.
    if let Some(shift) = guarded.and_then(|before| before.too_far(&workspace.map)) {
        return Ok(Processed::Refused(Refusal {
            outcomes: kept_out(&origins, BatchStatus::Quarantined, &shift.to_string()),
            origins,
        }));
    }

    // 8. Attribute what was added to the batches.
    let (added, mut outcomes) = attributed(job, &origins, &drives, extended, &workspace.map)?;
    let begins = matches!(known, Known::Before { .. });
    let clock_faults = match begins || !added.is_empty() {
        true => note_clock(&mut workspace, &drive, &vehicle, received_at, known, &start),
        false => Vec::new(),
    };
    let is_behind = match begins {
        true => start.clock_ahead_ns < 0 && !began_simulated(start.clock_ahead_ns),
        false => !clock_faults.is_empty(),
    };
    if is_behind {
        let flag = BatchFlag::ClockSkew.name().to_owned();
        outcomes[0].flags.push(flag);
    }

    // 9. Calibrate the trip's lidars and wheels, if enough of its scans are in the map now.
    let calibrations = calibrate(&mut workspace, &drive.trip, &vehicle, &start, &kept)?;

    // 10. Detect changes, update alerts, and collect what is to be saved.
    let (workspace, mut result) = conclude(workspace, job, &origins, added, outcomes)?;
    result.calibrations = calibrations;
    result.clock_faults = clock_faults;
    if begins {
        result.trip_start = Some((drive.trip, start));
    }
    Ok(Processed::Taken(Box::new((workspace, result))))
}

/// The outcome of the job's batch if it is refused whatever the map is.
fn refused_alone(
    job: &ClaimedJob,
    origins: &[Origin],
    drives: &[Drive],
) -> anyhow::Result<Option<BatchOutcome>> {
    let Some((origin, drive)) = origins.last().zip(drives.last()) else {
        return Ok(None);
    };
    match refuse_jump(origin, drive) {
        None if job.apart => try_apart(origin, drive).map(Some),
        refused => Ok(refused),
    }
}

/// What an extension added and how each batch ended.
///
/// # Errors
/// If the extension failed for another reason than that the trip could not be localised.
fn attributed(
    job: &ClaimedJob,
    origins: &[Origin],
    drives: &[Drive],
    extended: Result<Extension, NotExtended>,
    map: &RouteMap,
) -> anyhow::Result<(Added, Vec<BatchOutcome>)> {
    match extended {
        Ok(extension) => {
            let added = added_by(drives, &extension, map);
            let outcomes = merged(job, origins, &added, is_lost(map, &extension));
            Ok((added, outcomes))
        }
        Err(NotExtended::Unanchored(reason)) => {
            let outcomes = kept_out(origins, BatchStatus::Unanchored, &reason.to_string());
            Ok((Added::default(), outcomes))
        }
        Err(error) => Err(error.into()),
    }
}

/// Calibrates the trip's lidars that are due, and adds the results to the workspace.
///
/// # Errors
/// As [`Calibrations::put`](super::vehicles::Calibrations::put).
fn calibrate(
    workspace: &mut Workspace,
    trip: &TripId,
    vehicle: &VehicleId,
    start: &TripStart,
    kept: &KeptScans,
) -> anyhow::Result<Vec<TripCalibrationRecord>> {
    let trip_in_map = TripInMap {
        map: &workspace.map,
        vehicles: &workspace.vehicles,
        trip,
        vehicle,
        corrections: &start.corrections,
    };
    let calibrations = trip_in_map.calibrations(kept);
    for calibration in &calibrations {
        workspace.calibrations.put(calibration)?;
    }
    Ok(calibrations)
}

/// The poses that a trip must not move far, once the route is monitored: one more lap does not bend a
/// complete reference. Detector `seed` maps what was sent, as the paper does, and guards nothing.
fn guarded(workspace: &Workspace, trip: &TripId) -> Option<PosesBefore> {
    let is_complete = workspace.stage == Stage::Monitoring;
    let is_guarded = is_complete && !workspace.detector.keeps_as_sent();
    is_guarded.then(|| {
        let before = PosesBefore::of(&workspace.map, workspace.max_shift_m, |keyframe| {
            keyframe.trip == *trip
        });
        before.within_sigmas(&workspace.saved_nodes)
    })
}

/// Detects changes, corrects the map where a segment is misplaced, updates alerts, and collects what is to
/// be saved.
///
/// # Errors
/// As [`of_added`].
pub(super) fn conclude(
    mut workspace: Workspace,
    job: &ClaimedJob,
    origins: &[Origin],
    mut added: Added,
    mut outcomes: Vec<BatchOutcome>,
) -> anyhow::Result<(Workspace, JobResult)> {
    name_vehicles(&mut workspace, origins);
    let is_extended = !added.is_empty();
    let Detected { findings, mendings } = match is_extended {
        true => detect_in_scans(&mut workspace)?,
        false => Detected::default(),
    };
    for mending in &mendings {
        note_mending(job, mending);
        let closures = &mending.closures;
        added.edges.extend(
            closures
                .iter()
                .map(|closure| (closure.edge, added_closure(closure, 0))),
        );
    }
    if let Some(newest) = outcomes.last_mut().filter(|_| !mendings.is_empty()) {
        newest.flags.push(BatchFlag::MapMended.name().to_owned());
    }
    let mut result = of_added(&mut workspace, job, origins, &added)?;
    if is_extended {
        let findings = findings_of(&workspace, findings);
        let route = &job.route_id;
        result.alerts = fold_into(&mut workspace, route, &findings, &mendings, job.at);
    }
    workspace.stage = stage_of(&workspace);
    result.stage = workspace.stage;
    result.outcomes = outcomes;
    Ok((workspace, result))
}

fn note_mending(job: &ClaimedJob, mending: &Mending) {
    tracing::info!(
        route = %job.route_id,
        x_m = mending.shift.x,
        y_m = mending.shift.y,
        closures = mending.closures.len(),
        quarantined = mending.quarantined.len(),
        "a misplaced segment of the map was moved"
    );
    metrics::counter!("mapshift_map_mendings_total").increment(1);
}

fn decode(job: &ClaimedJob) -> anyhow::Result<(Vec<Origin>, Vec<Drive>)> {
    let (mut origins, mut drives) = (Vec::new(), Vec::new());
    for entry in &job.entries {
        let batch = batch_json::decode(&entry.body, entry.batch.received_at)
            .with_context(|| format!("the stored body of batch {} is refused", entry.batch.id))?;
        origins.push(Origin::of(&entry.batch));
        drives.push(Drive {
            trip: batch.trip_id,
            initial_pose: batch.initial_pose,
            scans: batch.scans,
            wheels: Corrections::default(),
        });
    }
    Ok((origins, drives))
}

/// Refuses a batch whose odometry jumps: the map's pictures and searches would have to span the empty
/// space in between for ever.
fn refuse_jump(origin: &Origin, drive: &Drive) -> Option<BatchOutcome> {
    let distance_m = |pair: &[DriveScan]| {
        let motion = pair[0].odom_from_base.between(&pair[1].odom_from_base);
        motion.translation().norm()
    };
    let longest_m = drive.scans.windows(2).map(distance_m).fold(0.0, f64::max);
    (longest_m > JUMP_MAX_M).then(|| BatchOutcome {
        reason: Some(format!(
            "the odometry jumps by {longest_m:.0} m from one scan to the next"
        )),
        ..outcome_of(origin, BatchStatus::Quarantined)
    })
}

/// Extends an empty map by a batch, after the process was lost while it was processed with others. If this
/// batch was the cause, the process is lost again, and the batch is known; else it waits with the others.
fn try_apart(origin: &Origin, drive: &Drive) -> anyhow::Result<BatchOutcome> {
    RouteMap::new(Weighting::Robust).extend(drive)?;
    Ok(BatchOutcome {
        reason: Some(
            "the service's process was lost while this batch was processed with those of its trip \
             that wait before it: it waits with them"
                .to_owned(),
        ),
        ..outcome_of(origin, BatchStatus::Unanchored)
    })
}

/// Joins the batches of a trip.
fn join(drives: &[Drive]) -> Drive {
    let mut joined = drives[0].clone();
    for drive in &drives[1..] {
        joined.scans.extend(drive.scans.iter().cloned());
    }
    joined
}

/// The outcomes of merged batches.
fn merged(job: &ClaimedJob, origins: &[Origin], added: &Added, is_lost: bool) -> Vec<BatchOutcome> {
    let outcomes = origins.iter();
    let outcomes = outcomes.map(|origin| outcome_of(origin, BatchStatus::Merged));
    let mut outcomes: Vec<BatchOutcome> = outcomes.collect();
    if job.after_gap {
        outcomes[0].flags.push(BatchFlag::Gap.name().to_owned());
    }
    if is_lost && let Some(newest) = outcomes.last_mut() {
        newest.flags.push(BatchFlag::NotLocalised.name().to_owned());
    }
    count_added(&mut outcomes, added);
    outcomes
}

/// Whether the newest node of an extension is not localised.
fn is_lost(map: &RouteMap, extension: &Extension) -> bool {
    let newest = extension.nodes.last().and_then(|node| map.keyframe(*node));
    newest.is_some_and(Keyframe::is_lost)
}
