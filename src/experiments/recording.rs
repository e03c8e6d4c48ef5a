//! Recordings as trips of one route, one after the other.

use std::sync::Arc;

use anyhow::ensure;

use crate::ids::{StampNs, TripId};
use crate::ingest::{LidarLog, RecordedScan};
use crate::scan::Lidar;

/// A log whose times overlap or precede those of the log before begins so long after it.
const PAUSE_NS: i64 = 3_600 * 1_000_000_000;

/// One trip of a route.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Its name.
    pub trip: TripId,
    /// The lidar of every scan.
    pub lidar: Arc<Lidar>,
    /// In the order of time.
    pub scans: Vec<RecordedScan>,
}

/// Logs in the order in which they are driven: each one's stamps are later than those before.
///
/// # Errors
/// If two of them have one name, or one has no scans.
pub fn in_sequence(
    logs: impl IntoIterator<Item = (TripId, LidarLog)>,
) -> anyhow::Result<Vec<Recording>> {
    let mut recordings: Vec<Recording> = Vec::new();
    for (trip, log) in logs {
        let named = recordings.iter().any(|earlier| earlier.trip == trip);
        ensure!(!named, "two recordings are named {trip}");
        let first = log.scans.first().map(|scan| scan.stamp);
        ensure!(first.is_some(), "{trip} has no scans");
        let last_before = recordings.last().and_then(|r| r.scans.last());
        let shift_ns = match (last_before.map(|scan| scan.stamp), first) {
            (Some(StampNs(last)), Some(StampNs(first))) if first <= last => last + PAUSE_NS - first,
            _ => 0,
        };
        let mut scans = log.scans;
        for scan in &mut scans {
            scan.stamp = StampNs(scan.stamp.0 + shift_ns);
        }
        recordings.push(Recording {
            trip,
            lidar: Arc::new(log.lidar),
            scans,
        });
    }
    Ok(recordings)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::CarmenLog;

    fn log(first_s: f64) -> LidarLog {
        let line = |s: f64| {
            format!("ROBOTLASER1 0 -0.1 0.2 0.1 5 0 0 3 1 2 3 0 0 0 0 0 0 0 0 0 0 0 0 {s} h {s}\n")
        };
        let text: String = (0..3).map(|k| line(first_s + f64::from(k))).collect();
        CarmenLog::read(text.as_bytes()).unwrap().into()
    }

    #[test]
    fn later_logs_have_later_stamps() {
        let trip = |name: &str| TripId::new(name).unwrap();
        let logs = [
            (trip("a"), log(0.0)),
            (trip("b"), log(1.0)),
            (trip("c"), log(90_000.0)),
        ];
        let recordings = in_sequence(logs.clone()).unwrap();
        let stamps: Vec<f64> = (recordings.iter())
            .flat_map(|r| r.scans.iter().map(|s| s.stamp.seconds()))
            .collect();
        assert!(stamps.is_sorted_by(|a, b| a < b), "{stamps:?}");
        assert!(
            (stamps[3] - stamps[2] - 3_600.0).abs() < 1e-6,
            "shifted by an hour"
        );
        assert_eq!(recordings[2].scans, logs[2].1.scans, "later already");
        assert!(in_sequence([(trip("a"), log(0.0)), (trip("a"), log(9.0))]).is_err());
    }
}
