//! What a trip's first job fixes for the whole trip: its clock offset and its vehicle's corrections.

use jiff::Timestamp;

use super::clock::{
    began_simulated, clock_ahead_ns, clock_behind_ns, is_set_backwards, simulated_ahead_ns,
    taken_from_ns,
};
use super::vehicles::primary_of;
use super::workspace::Workspace;
use crate::calibration::TripCorrections;
use crate::change::Detector;
use crate::ids::{StampNs, VehicleId};
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
    Decided(TripStart),
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
        return Ok(Known::Decided(TripStart::default()));
    };
    let (route, trip, vehicle) = (&job.route_id, &batch.trip_id, &batch.vehicle_id);
    if let Some(decided) = store.trip_start(route, trip).await? {
        return Ok(Known::Decided(decided));
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
        (Known::Decided(start), _) => start.clone(),
        (
            Known::Before {
                corrections,
                uploads,
            },
            Some((first, last)),
        ) if workspace.detector == Detector::Fused => {
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
