//! A simulated trip as batches to upload.

use jiff::Timestamp;

use crate::client::{EncodedBatch, ScanToSend, Trip};
use crate::ids::{StampNs, TripId, VehicleId};
use crate::scan::Lidar;
use crate::sim::SimScan;

const SCANS_PER_BATCH: usize = 30;
/// Pause of the vehicles between two laps, seconds.
const PAUSE_S: f64 = 5.0;

/// A vehicle's laps, each a trip of its own, cut into batches.
pub(super) struct Drive {
    pub vehicle_id: VehicleId,
    pub batches: Vec<LapBatch>,
}

/// Some scans of one lap.
pub(super) struct LapBatch {
    pub lap: usize,
    pub scans: usize,
    pub encoded: EncodedBatch,
}

/// When each lap is driven. All vehicles start a lap together, so that a change between two laps is at one time
/// for all of them.
pub(super) struct LapClock {
    now: Timestamp,
    /// How long before `now` each lap begins, seconds.
    before_now_s: Vec<f64>,
}

impl LapClock {
    /// The schedule of laps of which the last one ends at `now`.
    pub(super) fn new(recorded: &[Vec<SimScan>], now: Timestamp) -> Self {
        let mut before_now_s = Vec::new();
        for lap in recorded.iter().flat_map(|scans| laps_of(scans)) {
            let took_s = lap.last().map_or(0.0, |last| last.time_s - lap[0].time_s);
            let number = lap[0].lap;
            before_now_s.resize(before_now_s.len().max(number + 1), 0.0);
            before_now_s[number] = took_s.max(before_now_s[number]);
        }
        let mut later_s = 0.0;
        for lap_s in before_now_s.iter_mut().rev() {
            *lap_s += later_s;
            later_s = *lap_s + PAUSE_S;
        }
        Self { now, before_now_s }
    }

    /// The stamp of the scan `since_start_s` after the lap's first.
    fn stamp(&self, lap: usize, since_start_s: f64) -> StampNs {
        let before_now_ms = ((self.before_now_s[lap] - since_start_s) * 1e3).round() as i64;
        StampNs((self.now.as_millisecond() - before_now_ms) * 1_000_000)
    }
}

impl Drive {
    /// The drive of the vehicle with this number. It states where each lap starts; the first one only
    /// if `knows_start`.
    pub(super) fn new(
        number: usize,
        lidar: &Lidar,
        knows_start: bool,
        scans: &[SimScan],
        clock: &LapClock,
    ) -> anyhow::Result<Self> {
        let vehicle_id = VehicleId::new(format!("agv-{number:02}"))?;
        let name = clock.now.strftime("%Y%m%dT%H%M%S");
        let mut batches = Vec::new();
        for (k, lap) in laps_of(scans).enumerate() {
            let trip = Trip {
                trip_id: TripId::new(format!("{vehicle_id}-{name}-{}", k + 1))?,
                vehicle_id: vehicle_id.clone(),
                lidar: lidar.clone(),
                initial_pose: (k > 0 || knows_start).then_some(lap[0].map_from_base),
            };
            for (sequence, chunk) in lap.chunks(SCANS_PER_BATCH).enumerate() {
                let to_send = chunk.iter().map(|scan| ScanToSend {
                    stamp: clock.stamp(scan.lap, scan.time_s - lap[0].time_s),
                    odom_from_base: scan.odom_from_base,
                    ranges_m: &scan.ranges_m,
                });
                batches.push(LapBatch {
                    lap: lap[0].lap,
                    scans: chunk.len(),
                    encoded: trip.encode(sequence, to_send)?,
                });
            }
        }
        Ok(Self {
            vehicle_id,
            batches,
        })
    }
}

fn laps_of(scans: &[SimScan]) -> impl Iterator<Item = &[SimScan]> {
    scans.chunk_by(|a, b| a.lap == b.lap)
}
