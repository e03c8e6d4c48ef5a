//! Vehicle clocks that are ahead or behind.
//!
//! The passes by a place are judged in the order of their stamps. With a clock years ahead a vehicle would
//! be the newest observer for years; with one hours behind, its observations would count as older than they
//! are. Trips of both are dated by their arrival instead. A late upload differs from a clock that is behind:
//! the vehicle's previous trip shows whether it uploads while it drives.
//!
//! A simulation's clock begins at 0, as does one that was never set. Such a trip is dated by its arrival, but
//! after everything in the map: trips of a simulation that is faster than real time, and of the next one that
//! begins at 0 again, stay in the order of arrival.

use jiff::Timestamp;

use crate::ids::{StampNs, TripId};
use crate::mapping::{Drive, DriveScan, RouteMap};
use crate::store::UploadLag;

/// A clock that is farther ahead is not believed, nanoseconds.
const AHEAD_MAX_NS: i64 = 7 * 24 * 3_600 * 1_000_000_000;
/// Gap between the newest scan of other trips and the first of a trip that is dated after it, nanoseconds.
const GAP_NS: i64 = 1_000_000_000;

/// Largest lag of a vehicle that uploads while it drives, nanoseconds.
const LIVE_MAX_NS: i64 = 600 * 1_000_000_000;
/// A clock that is behind by less cannot be distinguished from a slow upload, nanoseconds …
const BEHIND_MIN_NS: i64 = 3_600 * 1_000_000_000;
/// … and one that is farther behind is a recording, nanoseconds.
const BEHIND_MAX_NS: i64 = 30 * 24 * 3_600 * 1_000_000_000;
/// Fewest batches that show whether a trip was uploaded while it was driven.
const BATCHES_MIN: usize = 3;

/// How far the clock of a trip is behind whose first batch has scans between these stamps, nanoseconds: 0 if
/// it is believed. `before` are the batches of the vehicle's previous trip. If that was uploaded while it was
/// driven, the clock is behind if it was behind by as much then, or was set back since.
pub(super) fn clock_behind_ns(
    [first, last]: [StampNs; 2],
    received_at: Timestamp,
    before: &[UploadLag],
) -> i64 {
    let behind_ns = nanoseconds(received_at).saturating_sub(last.0);
    let Some(usual_ns) = lag_of_live(before) else {
        return 0;
    };
    let newest = before.iter().map(|upload| upload.newest).max();
    let has_gone_back = usual_ns < LIVE_MAX_NS && newest > Some(first);
    let is_as_before = usual_ns > BEHIND_MIN_NS
        && behind_ns.abs_diff(usual_ns) < LIVE_MAX_NS.unsigned_abs() + usual_ns.unsigned_abs() / 20;
    let is_believed = !(BEHIND_MIN_NS..BEHIND_MAX_NS).contains(&behind_ns);
    match (has_gone_back || is_as_before) && !is_believed {
        true => behind_ns,
        false => 0,
    }
}

/// The largest lag of a trip that was uploaded while it was driven, nanoseconds; `None` if it was not: a
/// recording arrives all at once, so that the lag of its first batch is the largest.
fn lag_of_live(batches: &[UploadLag]) -> Option<i64> {
    let lag_ns = |batch: &UploadLag| nanoseconds(batch.received_at).saturating_sub(batch.newest.0);
    let lags = || batches.iter().map(lag_ns);
    let stamps = || batches.iter().map(|batch| batch.newest.0);
    let span_ns = stamps().max()?.saturating_sub(stamps().min()?);
    let spread_ns = lags().max()?.saturating_sub(lags().min()?);
    let is_live = batches.len() >= BATCHES_MIN && spread_ns < span_ns / 3;
    lags().max().filter(|_| is_live)
}

/// How far the clock of a trip is behind whose batches arrive as it is driven, hours after they are stamped,
/// nanoseconds.
pub(super) fn steadily_behind_ns(batches: &[UploadLag]) -> Option<i64> {
    lag_of_live(batches).filter(|lag_ns| (BEHIND_MIN_NS..BEHIND_MAX_NS).contains(lag_ns))
}

/// Whether most of the vehicles that upload as they drive do so on time; their newest trips' batches.
pub(super) fn are_on_time(vehicles: &[Vec<UploadLag>]) -> bool {
    let live = || vehicles.iter().filter_map(|batches| lag_of_live(batches));
    let on_time = live().filter(|lag_ns| *lag_ns < LIVE_MAX_NS);
    2 * on_time.count() > live().count()
}

/// Whether a batch that ends with a stamp arrived on time.
pub(super) fn is_on_time(last: StampNs, received_at: Timestamp) -> bool {
    nanoseconds(received_at).saturating_sub(last.0) < BEHIND_MIN_NS
}

fn nanoseconds(time: Timestamp) -> i64 {
    i64::try_from(time.as_nanosecond()).unwrap_or(i64::MAX)
}

/// How far the clock of a trip that begins with these scans is ahead, nanoseconds: 0 if it is believed. The
/// trip stays after all that is earlier by its own stamps, even if those are ahead too: simulated days are
/// driven in minutes.
pub(super) fn clock_ahead_ns(
    scans: &[DriveScan],
    received_at: Timestamp,
    map: &RouteMap,
    trip: &TripId,
) -> i64 {
    let (Some(first), Some(last)) = (scans.first(), scans.last()) else {
        return 0;
    };
    let ahead_ns = last.stamp.0.saturating_sub(nanoseconds(received_at));
    if ahead_ns <= AHEAD_MAX_NS {
        return 0;
    }
    match newest_of_others(map, trip, first.stamp.0) {
        Some(before) => ahead_ns.min(first.stamp.0 - before - GAP_NS).max(0),
        None => ahead_ns,
    }
}

/// What to subtract from the simulated stamps of a trip that begins with these scans, nanoseconds, below 0;
/// `None` if its stamps are times.
pub(super) fn simulated_ahead_ns(
    scans: &[DriveScan],
    received_at: Timestamp,
    map: &RouteMap,
    trip: &TripId,
) -> Option<i64> {
    let simulated = || scans.iter().filter(|scan| scan.stamp.is_simulated());
    let (first, last) = simulated().next().zip(simulated().next_back())?;
    let begun_ns = nanoseconds(received_at).saturating_sub(last.stamp.0 - first.stamp.0);
    let after_others_ns = newest_of_others(map, trip, i64::MAX)
        .map_or(i64::MIN, |newest_ns| newest_ns.saturating_add(GAP_NS));
    Some(first.stamp.0 - begun_ns.max(after_others_ns))
}

/// Whether a trip began with simulated stamps, by what is taken from them: no other clock is believed
/// to be that far behind.
pub(super) fn began_simulated(clock_ahead_ns: i64) -> bool {
    clock_ahead_ns < -BEHIND_MAX_NS
}

/// What to subtract from a stamp of a trip, nanoseconds. A clock that was set during the trip is believed
/// from then on.
pub(super) fn taken_from_ns(stamp: StampNs, clock_ahead_ns: i64) -> i64 {
    match began_simulated(clock_ahead_ns) && !stamp.is_simulated() {
        true => 0,
        false => clock_ahead_ns,
    }
}

/// Whether a clock that was set during the trip moved its stamps backwards: the first scans with times are
/// earlier than the corrected stamps of those before.
pub(super) fn is_set_backwards(drive: &Drive, clock_ahead_ns: i64, map: &RouteMap) -> bool {
    if !began_simulated(clock_ahead_ns) {
        return false;
    }
    let stamps = || drive.scans.iter().map(|scan| scan.stamp);
    let simulated = stamps().filter(|stamp| stamp.is_simulated());
    let simulated_ns = simulated.map(|stamp| stamp.0.saturating_sub(clock_ahead_ns));
    let known_ns = stamps_of(map, |trip| *trip == drive.trip);
    let first_set = stamps().find(|stamp| !stamp.is_simulated());
    let newest_ns = simulated_ns.chain(known_ns).max();
    first_set.is_some_and(|first| newest_ns.is_some_and(|newest_ns| first.0 < newest_ns))
}

/// The newest stamp before another of the scans of other trips, nanoseconds.
fn newest_of_others(map: &RouteMap, trip: &TripId, before_ns: i64) -> Option<i64> {
    let stamps = stamps_of(map, |other| other != trip);
    stamps.filter(|stamp| *stamp < before_ns).max()
}

/// The stamps of the scans of some trips, nanoseconds.
fn stamps_of(map: &RouteMap, is_meant: impl Fn(&TripId) -> bool) -> impl Iterator<Item = i64> {
    let keyframes = map.keyframes().iter();
    let meant = keyframes.filter(move |keyframe| is_meant(&keyframe.trip));
    meant.flat_map(|keyframe| {
        let behind = keyframe.intermediate.iter().map(|scan| scan.stamp.0);
        behind.chain([keyframe.stamp.0])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    const SECOND_NS: i64 = 1_000_000_000;
    const HOUR_S: i64 = 3_600;
    /// Where the test's time begins, by the service's clock.
    const BEGUN_S: i64 = 1_790_000_000;

    fn at(second: i64) -> Timestamp {
        Timestamp::from_second(BEGUN_S + second).unwrap()
    }

    /// Batches of 20 s each that arrive `late_s` after their end, by a clock that is behind.
    fn trip(behind_s: i64, late_s: impl Fn(i64) -> i64) -> Vec<UploadLag> {
        let batch = |k: i64| UploadLag {
            newest: StampNs((BEGUN_S + 20 * k - behind_s) * SECOND_NS),
            received_at: at(20 * k + late_s(k)),
        };
        (1..=6).map(batch).collect()
    }

    /// How far behind the clock is found of a batch of 20 s that ends at a second and arrives at another.
    fn found_s(before: &[UploadLag], ends_s: i64, arrives_s: i64) -> i64 {
        let stamps = [ends_s - 20, ends_s].map(|second| StampNs((BEGUN_S + second) * SECOND_NS));
        clock_behind_ns(stamps, at(arrives_s), before) / SECOND_NS
    }

    #[test]
    fn a_clock_that_goes_back_is_noticed_at_once() {
        let before = trip(0, |k| k % 3);
        let now_s = 2 * HOUR_S;
        assert_eq!(found_s(&before, now_s - 20 * HOUR_S, now_s), 20 * HOUR_S);
        assert_eq!(found_s(&before, now_s, now_s + 1), 0, "on time");
    }

    #[test]
    fn a_clock_that_stays_behind_is_noticed_with_the_second_trip() {
        let before = trip(20 * HOUR_S, |k| 2 + k % 3);
        let now_s = 5 * HOUR_S;
        let late_s = 20 * HOUR_S + 40;
        assert_eq!(found_s(&before, now_s - late_s, now_s), late_s);
        assert_eq!(found_s(&before, now_s - 10, now_s), 0, "it was put right");
    }

    #[test]
    fn a_first_trip_is_behind_beside_vehicles_that_are_on_time() {
        let behind = trip(20 * HOUR_S, |k| 2 + k % 3);
        let found_ns = steadily_behind_ns(&behind).unwrap();
        assert_eq!(found_ns / SECOND_NS, 20 * HOUR_S + 4);
        assert_eq!(steadily_behind_ns(&trip(0, |_| 1)), None, "on time");
        let kept = trip(0, |k| 20 * HOUR_S - 20 * k);
        assert_eq!(steadily_behind_ns(&kept), None, "kept, and sent at once");
        assert_eq!(steadily_behind_ns(&behind[..2]), None, "too few batches");
        let live = trip(0, |_| 1);
        assert!(are_on_time(&[live.clone(), kept.clone(), Vec::new()]));
        assert!(are_on_time(&[live.clone(), live.clone(), behind.clone()]));
        assert!(!are_on_time(&[live, behind]), "no more than half of them");
        assert!(!are_on_time(&[kept]) && !are_on_time(&[]), "nobody is live");
    }

    #[test]
    fn what_is_uploaded_late_is_believed() {
        let now_s = 30 * HOUR_S;
        // Kept for 20 hours, and sent at once.
        let kept = trip(0, |k| 20 * HOUR_S - 20 * k);
        assert_eq!(found_s(&kept, now_s - 20 * HOUR_S, now_s), 0);
        // Driven after what is known, while there was no network.
        let live = trip(0, |_| 1);
        assert_eq!(found_s(&live, 5 * HOUR_S, now_s), 0);
        assert_eq!(
            found_s(&live[..2], -20 * HOUR_S, now_s),
            0,
            "too few batches"
        );
        assert_eq!(found_s(&[], -20 * HOUR_S, now_s), 0);
        let recording = trip(3_000 * HOUR_S, |_| 1);
        assert_eq!(found_s(&recording, now_s - 3_000 * HOUR_S, now_s), 0);
    }
}
