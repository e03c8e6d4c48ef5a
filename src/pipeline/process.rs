//! One job of scans, from its bodies to what is to be saved: the computation, without any waiting.

use anyhow::Context;
use jiff::Timestamp;

use super::alerts::fold_into;
use super::calibrate::{Asked, kept_scans};
use super::clock::{
    began_simulated, clock_ahead_ns, clock_behind_ns, is_on_time, is_set_backwards,
    simulated_ahead_ns, taken_from_ns,
};
use super::findings::{Observed, findings as all_findings, observed};
use super::refusal::{Processed, Refusal};
use super::result::{
    Added, AddedEdge, AddedNode, Origin, closure_record, kept_out, name_vehicles, of_added,
    outcome_of,
};
use super::shift::PosesBefore;
use super::stage::stage_of;
use super::vehicles::{corrected, primary_of};
use super::workspace::Workspace;
use crate::calibration::{Corrections, TripCorrections};
use crate::ids::{NodeId, StampNs, TripId, VehicleId};
use crate::ingest::batch_json;
use crate::mapping::{
    Closure, Drive, DriveScan, Extension, Keyframe, Mending, NotExtended, RouteMap, Weighting,
};
use crate::model::{BatchFlag, BatchStatus, Stage};
use crate::store::{BatchOutcome, ClaimedJob, ClockFault, JobResult, TripStart, UploadLag};

/// No vehicle drives this far between two scans, metres.
const JUMP_MAX_M: f64 = 100.0;

/// Why scans are kept out that cannot be put in the order of time with those of their trip.
const CLOCK_FELL_BACK: &str = "the stamps are before 2000, those of the trip before are not: after a \
                               simulation or a vehicle's clock has started anew, begin a new trip";

/// Why scans are kept out whose clock was set to a time that their trip has passed.
const CLOCK_SET_BACKWARDS: &str = "the clock was set in the middle of the trip, to a time that is earlier than \
                                   the scans before: after a clock is set, begin a new trip";

/// What is known of a job's trip.
pub(super) enum Known {
    /// It goes on.
    Decided {
        /// What was decided when it began.
        start: TripStart,
        /// How far its clock is found to be behind since, nanoseconds.
        behind_ns: Option<i64>,
    },
    /// The trip begins now.
    Before {
        /// What was corrected in the vehicle's newest trip that has said something.
        corrections: TripCorrections,
        /// How the batches of the vehicle's trip before arrived.
        uploads: Vec<UploadLag>,
    },
}

/// Takes the job's batches through the map, with the vehicle's corrections.
///
/// # Errors
/// If a journalled body cannot be decoded, or the graph refuses an id; the workspace is lost
/// then.
pub(super) fn process(
    mut workspace: Workspace,
    job: &ClaimedJob,
    known: &Known,
) -> anyhow::Result<Processed> {
    let (origins, mut drives) = decode(job)?;
    let newest = origins.last().zip(drives.last());
    let refused = match newest.and_then(refuse_jump) {
        None if job.apart => newest.map(try_apart).transpose()?,
        refused => refused,
    };
    if let Some(outcome) = refused {
        return Ok(Processed::Refused(Refusal {
            origins,
            outcomes: vec![outcome],
        }));
    }
    let vehicle = origins.last().map(|origin| origin.vehicle_id.clone());
    let vehicle = vehicle.context("a job without batches")?;
    let received_at = job.entries[0].batch.received_at;
    let mut drive = join(&drives);
    let start = trip_start(&workspace, &vehicle, &drive, received_at, known);
    if let Some(reason) = out_of_order(&drive, start.clock_ahead_ns, &workspace.map) {
        let newest = &origins[origins.len() - 1..];
        return Ok(Processed::Refused(Refusal {
            outcomes: kept_out(newest, BatchStatus::Quarantined, reason),
            origins,
        }));
    }
    for drive in drives.iter_mut().chain([&mut drive]) {
        set_back(drive, start.clock_ahead_ns);
    }
    let corrections = &start.corrections;
    let drive = corrected(drive, corrections);
    let kept = kept_scans(&workspace.map, &drive.trip);
    let guarded = guarded(&workspace, &drive.trip);
    let extended = workspace.map.extend(&drive);
    if let Some(shift) = guarded.and_then(|before| before.too_far(&workspace.map)) {
        return Ok(Processed::Refused(Refusal {
            outcomes: kept_out(&origins, BatchStatus::Quarantined, &shift.to_string()),
            origins,
        }));
    }
    let begins = matches!(known, Known::Before { .. });
    let (added, mut outcomes) = match extended {
        Ok(extension) => {
            let added = added_by(&drives, &extension, &workspace.map);
            let is_lost = is_lost(&workspace.map, &extension);
            let outcomes = merged(job, &origins, &added, is_lost);
            (added, outcomes)
        }
        Err(NotExtended::Unanchored(reason)) => {
            let outcomes = kept_out(&origins, BatchStatus::Unanchored, &reason.to_string());
            (Added::default(), outcomes)
        }
        Err(error) => return Err(error.into()),
    };
    let clock_faults = match begins || !added.is_nothing() {
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
    let asked = Asked {
        map: &workspace.map,
        vehicles: &workspace.vehicles,
        trip: &drive.trip,
        vehicle: &vehicle,
        corrections,
    };
    let words = asked.calibrations(&kept);
    for word in &words {
        workspace.calibrations.put(word)?;
    }
    let (workspace, mut result) = conclude(workspace, job, &origins, added, outcomes)?;
    result.calibrations = words;
    result.clock_faults = clock_faults;
    if begins {
        result.trip_start = Some((drive.trip, start));
    }
    Ok(Processed::Taken(Box::new((workspace, result))))
}

/// Why scans cannot be put in the order of time with those of their trip, if they cannot.
fn out_of_order(drive: &Drive, clock_ahead_ns: i64, map: &RouteMap) -> Option<&'static str> {
    let has_simulated = drive.scans.iter().any(|scan| scan.stamp.is_simulated());
    if has_simulated && !began_simulated(clock_ahead_ns) {
        return Some(CLOCK_FELL_BACK);
    }
    is_set_backwards(drive, clock_ahead_ns, map).then_some(CLOCK_SET_BACKWARDS)
}

/// What a drive of a trip may not move far: a reference that is complete is not bent by one more lap. A
/// map by the paper's rule is what the paper would make of what was sent.
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

/// What is corrected of a trip, and by its clock. A map by the paper's rule corrects nothing: it is what
/// the paper would make of what was sent; only simulated stamps become times there too.
fn trip_start(
    workspace: &Workspace,
    vehicle: &VehicleId,
    drive: &Drive,
    received_at: Timestamp,
    known: &Known,
) -> TripStart {
    let ends = drive.scans.first().zip(drive.scans.last());
    let (map, trip) = (&workspace.map, &drive.trip);
    let simulated_ns = simulated_ahead_ns(&drive.scans, received_at, map, trip);
    match (known, ends) {
        (Known::Decided { start, .. }, _) => start.clone(),
        (
            Known::Before {
                corrections,
                uploads,
            },
            Some((first, last)),
        ) if !workspace.detector.keeps_as_sent() => {
            let clock_ahead_ns = simulated_ns.unwrap_or_else(|| {
                clock_ahead_ns(&drive.scans, received_at, map, trip)
                    - clock_behind_ns([first.stamp, last.stamp], received_at, uploads)
            });
            let begins = (trip, StampNs(first.stamp.0 - clock_ahead_ns));
            let primary = primary_of(drive);
            let calibrations = &workspace.calibrations;
            TripStart {
                corrections: calibrations.corrections_for(vehicle, corrections, primary, begins),
                clock_ahead_ns,
            }
        }
        _ => TripStart {
            clock_ahead_ns: simulated_ns.unwrap_or(0),
            ..TripStart::default()
        },
    }
}

/// Notes that the clock of a trip is behind, or with a trip that arrives on time that it is right again; returns
/// what is new.
fn note_clock(
    workspace: &mut Workspace,
    drive: &Drive,
    vehicle: &VehicleId,
    received_at: Timestamp,
    known: &Known,
    start: &TripStart,
) -> Vec<ClockFault> {
    let Some((first, last)) = drive.scans.first().zip(drive.scans.last()) else {
        return Vec::new();
    };
    match known {
        Known::Decided {
            behind_ns: Some(behind_ns),
            ..
        } => {
            let keyframes = workspace.map.keyframes().iter();
            let own = keyframes.filter(|keyframe| keyframe.trip == drive.trip);
            let scans: usize = kept_scans(&workspace.map, &drive.trip).values().sum();
            let fault = ClockFault {
                trip: drive.trip.clone(),
                vehicle: vehicle.clone(),
                behind_ns: *behind_ns,
                since: own.map(|own| own.stamp).min().unwrap_or(first.stamp),
                last_seen: last.stamp,
                scans: u32::try_from(scans).unwrap_or(u32::MAX),
                until: None,
            };
            workspace.map.distrust([drive.trip.clone()]);
            workspace.clock_faults.put(fault.clone());
            vec![fault]
        }
        Known::Before { .. }
            if start.clock_ahead_ns == 0 && is_on_time(last.stamp, received_at) =>
        {
            workspace.clock_faults.end(vehicle, first.stamp)
        }
        _ => Vec::new(),
    }
}

/// Takes from a drive's stamps what its clock is ahead, or gives them what it is behind.
fn set_back(drive: &mut Drive, clock_ahead_ns: i64) {
    for scan in &mut drive.scans {
        scan.stamp.0 -= taken_from_ns(scan.stamp, clock_ahead_ns);
    }
}

/// Judges what was added, mends the map where it can be, and gathers what is to be saved.
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
    let is_news = !added.is_nothing();
    let Observed { findings, mendings } = match is_news {
        true => observed(&mut workspace)?,
        false => Observed::default(),
    };
    for mending in &mendings {
        note_mending(job, mending);
        let closures = &mending.closures;
        added.edges.extend(
            closures
                .iter()
                .map(|closure| (closure.edge, closed_by(closure, 0))),
        );
    }
    if let Some(newest) = outcomes.last_mut().filter(|_| !mendings.is_empty()) {
        newest.flags.push(BatchFlag::MapMended.name().to_owned());
    }
    let mut result = of_added(&mut workspace, job, origins, &added)?;
    if is_news {
        let findings = all_findings(&workspace, findings);
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
        "a segment of the map was put right"
    );
    metrics::counter!("mapshift_map_mendings_total").increment(1);
}

/// Counts what each batch added.
pub(super) fn count_added(outcomes: &mut [BatchOutcome], added: &Added) {
    for node in added.nodes.values() {
        outcomes[node.origin].nodes_added += 1;
    }
    for edge in added.edges.values().filter(|edge| edge.delta_f.is_some()) {
        outcomes[edge.origin].loop_closures += 1;
    }
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

/// Keeps out a batch whose odometry would put its scans where nothing is: the map's pictures and
/// searches would have to span the way there for ever.
fn refuse_jump((origin, drive): (&Origin, &Drive)) -> Option<BatchOutcome> {
    let way_m = |pair: &[DriveScan]| {
        let motion = pair[0].odom_from_base.between(&pair[1].odom_from_base);
        motion.translation().norm()
    };
    let longest_m = drive.scans.windows(2).map(way_m).fold(0.0, f64::max);
    (longest_m > JUMP_MAX_M).then(|| BatchOutcome {
        reason: Some(format!(
            "the odometry jumps by {longest_m:.0} m from one scan to the next"
        )),
        ..outcome_of(origin, BatchStatus::Quarantined)
    })
}

/// Takes a batch through an empty map, which ends the process if the batch is why one was lost. If it
/// is not, the batch waits with those before it.
fn try_apart((origin, drive): (&Origin, &Drive)) -> anyhow::Result<BatchOutcome> {
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

/// The drives of a trip that waited together, as one.
fn join(drives: &[Drive]) -> Drive {
    let mut joined = drives[0].clone();
    for drive in &drives[1..] {
        joined.scans.extend(drive.scans.iter().cloned());
    }
    joined
}

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

/// Whether nobody knows where the newest node of an extension is.
fn is_lost(map: &RouteMap, extension: &Extension) -> bool {
    let newest = extension.nodes.last().and_then(|node| map.keyframe(*node));
    newest.is_some_and(Keyframe::is_lost)
}

/// What an extension added: a node came with its scan, an edge with its newer node.
fn added_by(drives: &[Drive], extension: &Extension, map: &RouteMap) -> Added {
    let nodes = extension.nodes.iter().map(|node| {
        let node_added = AddedNode {
            origin: part_with(drives, map, *node),
            client_id: None,
        };
        (*node, node_added)
    });
    let edges = extension.edges.iter().filter_map(|id| {
        let edge_added = AddedEdge {
            origin: part_with(drives, map, map.graph().edge(*id)?.to),
            delta_f: None,
            closure: None,
        };
        Some((*id, edge_added))
    });
    let mut added = Added {
        nodes: nodes.collect(),
        edges: edges.collect(),
        intermediate: extension.intermediate.clone(),
    };
    for closure in &extension.closures {
        if let Some(edge) = added.edges.get_mut(&closure.edge) {
            *edge = closed_by(closure, edge.origin);
        }
    }
    added
}

fn closed_by(closure: &Closure, origin: usize) -> AddedEdge {
    AddedEdge {
        origin,
        delta_f: Some(closure.delta_f),
        closure: Some(closure_record(closure)),
    }
}

/// The drive that a new node's scan came with, as a place among them.
fn part_with(drives: &[Drive], map: &RouteMap, node: NodeId) -> usize {
    let position = map.graph().node_position(node).unwrap_or_default();
    let stamp = map.keyframes()[position].stamp;
    let holds = |drive: &Drive| {
        let scans = &drive.scans;
        scans.first().is_some_and(|first| first.stamp <= stamp)
            && scans.last().is_some_and(|last| stamp <= last.stamp)
    };
    drives.iter().position(holds).unwrap_or(drives.len() - 1)
}
