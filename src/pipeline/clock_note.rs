//! What a job notes of its trip's clock, for its route's [`ClockFaults`](super::clock_faults::ClockFaults).

use jiff::Timestamp;

use super::calibrate::kept_scans;
use super::clock::is_on_time;
use super::trip_start::Known;
use super::workspace::Workspace;
use crate::ids::VehicleId;
use crate::mapping::Drive;
use crate::store::{ClockFault, TripStart};

/// Notes that a trip's clock is behind, or, with a trip that arrives on time, that its vehicle's clock is right
/// again; returns what is new.
pub(super) fn note_clock(
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
