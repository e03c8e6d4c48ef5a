//! What a trip's first job fixes for the whole trip: its clock offset and its vehicle's corrections.

use jiff::Timestamp;

use super::clock::{
    are_on_time, began_simulated, clock_ahead_ns, clock_behind_ns, is_set_backwards,
    simulated_ahead_ns, steadily_behind_ns, taken_from_ns,
};
use super::vehicles::primary_of;
use super::workspace::Workspace;
use crate::calibration::TripCorrections;
use crate::ids::{RouteId, StampNs, TripId, VehicleId};
use crate::mapping::{Drive, RouteMap};
use crate::store::{ClaimedJob, JournalEntry, Store, StoreError, TripStart, UploadLag};

/// Reason of a refusal: the scans cannot be ordered in time with those of their trip.
const CLOCK_FELL_BACK: &str = "the stamps are before 2000, those of the trip before are not: after a \
                               simulation or a vehicle's clock has started anew, begin a new trip";

/// Reason of a refusal: the clock was set to a time that the trip has already passed.
const CLOCK_SET_BACKWARDS: &str = "the clock was set in the middle of the trip, to a time that is earlier than \
                                   the scans before: after a clock is set, begin a new trip";

/// What the store knows about a job's trip.
pub(super) enum Known {
    /// An earlier job of the trip fixed its start.
    Decided {
        /// What was fixed.
        start: TripStart,
        /// How far the trip's clock is found to be behind since, nanoseconds.
        behind_ns: Option<i64>,
    },
    /// This job is the trip's first.
    Before {
        /// The corrections of the vehicle's newest calibrated trip.
        corrections: TripCorrections,
        /// How late the batches of the vehicle's previous trip arrived.
        uploads: Vec<UploadLag>,
    },
}

/// Reads what is known about a job's trip. It depends on earlier jobs alone, in their order, so a replay
/// reads the same.
///
/// # Errors
/// [`StoreError`].
pub(super) async fn known_start(
    store: &Store,
    workspace: &Workspace,
    job: &ClaimedJob,
) -> Result<Known, StoreError> {
    let Some(JournalEntry { batch, .. }) = job.entries.last() else {
        return Ok(Known::Decided {
            start: TripStart::default(),
            behind_ns: None,
        });
    };
    let (route, trip, vehicle) = (&job.route_id, &batch.trip_id, &batch.vehicle_id);
    if let Some(start) = store.trip_start(route, trip).await? {
        let is_trusted = start.clock_ahead_ns == 0 && !workspace.clock_faults.has(trip);
        let behind_ns = match is_trusted && !workspace.detector.keeps_as_sent() {
            true => found_behind_ns(store, route, vehicle, trip).await?,
            false => None,
        };
        return Ok(Known::Decided { start, behind_ns });
    }
    let newest = workspace.calibrations.newest_trip(vehicle);
    let before = match newest {
        Some(trip) => store.trip_start(route, trip).await?,
        None => None,
    };
    Ok(Known::Before {
        corrections: before.unwrap_or_default().corrections,
        uploads: store.upload_lags(route, vehicle, trip).await?,
    })
}

/// How far the clock of a trip that is being driven is behind, by the arrival of its batches so far and of those
/// of vehicles that are on time, nanoseconds.
async fn found_behind_ns(
    store: &Store,
    route: &RouteId,
    vehicle: &VehicleId,
    trip: &TripId,
) -> Result<Option<i64>, StoreError> {
    let own = store.trip_lags(route, trip).await?;
    let Some(behind_ns) = steadily_behind_ns(&own) else {
        return Ok(None);
    };
    let others = store.lags_of_others(route, vehicle, trip).await?;
    Ok(Some(behind_ns).filter(|_| are_on_time(&others)))
}

/// A trip's corrections and clock offset, fixed by its first job. Detector `seed` corrects nothing, to map
/// what was sent as the paper does; only simulated stamps become times there too.
pub(super) fn trip_start(
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

/// Why stamps cannot be ordered with the earlier ones of their trip; `None` if they can.
pub(super) fn clock_fault(
    drive: &Drive,
    clock_ahead_ns: i64,
    map: &RouteMap,
) -> Option<&'static str> {
    let has_simulated = drive.scans.iter().any(|scan| scan.stamp.is_simulated());
    if has_simulated && !began_simulated(clock_ahead_ns) {
        return Some(CLOCK_FELL_BACK);
    }
    is_set_backwards(drive, clock_ahead_ns, map).then_some(CLOCK_SET_BACKWARDS)
}

/// Subtracts the clock offset from all stamps.
pub(super) fn correct_stamps(drive: &mut Drive, clock_ahead_ns: i64) {
    for scan in &mut drive.scans {
        scan.stamp.0 -= taken_from_ns(scan.stamp, clock_ahead_ns);
    }
}
