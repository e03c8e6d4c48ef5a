//! Flags: oddities of a batch that are no reason to refuse it.

use jiff::Timestamp;

use super::ranges::RangeCounts;
use crate::ids::StampNs;
use crate::mapping::DriveScan;
use crate::model::BatchFlag;

/// Faster than any vehicle on a route, m/s.
const SPEED_MAX_M_PER_S: f64 = 50.0;
/// Stamps further in the future than this are a wrong clock, nanoseconds.
const SKEW_MAX_NS: i128 = 24 * 3_600 * 1_000_000_000;
/// Stamps older than this are late, nanoseconds.
const LATE_MIN_NS: i128 = 30 * SKEW_MAX_NS;

/// The flags in alphabetical order.
pub(super) fn flags(
    scans: &[DriveScan],
    received_at: Timestamp,
    ranges: &RangeCounts,
    has_clockwise: bool,
) -> Vec<String> {
    let stamps = scans.iter().map(|scan| scan.stamp);
    let mut flags = raised_by_clock(stamps, received_at);
    let others = [
        (BatchFlag::AboveRangeMax, ranges.above_range_max > 0),
        (BatchFlag::BelowRangeMin, ranges.below_range_min > 0),
        (BatchFlag::ClockwiseScans, has_clockwise),
        (
            BatchFlag::EmptyScans,
            scans.iter().any(|s| s.scan.return_count() == 0),
        ),
        (BatchFlag::WildOdometry, scans.windows(2).any(is_wild)),
    ];
    flags.extend(others.iter().filter(|(_, raised)| *raised).map(|(f, _)| *f));
    names(flags)
}

/// The flags that depend on stamps alone.
pub(in crate::ingest) fn clock_flags(stamps: &[StampNs], received_at: Timestamp) -> Vec<String> {
    names(raised_by_clock(stamps.iter().copied(), received_at))
}

/// Simulated times are neither early nor late.
fn raised_by_clock(
    stamps: impl Iterator<Item = StampNs> + Clone,
    received_at: Timestamp,
) -> Vec<BatchFlag> {
    let age_ns = |stamp: StampNs| received_at.as_nanosecond() - i128::from(stamp.0);
    let mut real = stamps.clone().filter(|stamp| !stamp.is_simulated());
    let mut simulated = stamps.filter(|stamp| stamp.is_simulated());
    let flags = [
        (
            BatchFlag::ClockSkew,
            real.clone().any(|s| age_ns(s) < -SKEW_MAX_NS),
        ),
        (BatchFlag::Late, real.any(|s| age_ns(s) > LATE_MIN_NS)),
        (BatchFlag::SimulatedTime, simulated.next().is_some()),
    ];
    let raised = flags.into_iter().filter(|(_, raised)| *raised);
    raised.map(|(flag, _)| flag).collect()
}

fn names(flags: Vec<BatchFlag>) -> Vec<String> {
    let mut names: Vec<String> = flags.iter().map(|flag| flag.name().to_owned()).collect();
    names.sort_unstable();
    names
}

fn is_wild(pair: &[DriveScan]) -> bool {
    let [before, after] = pair else { return false };
    let elapsed_s = (after.stamp.0 - before.stamp.0) as f64 * 1e-9;
    let motion = before.odom_from_base.between(&after.odom_from_base);
    motion.translation().norm() > SPEED_MAX_M_PER_S * elapsed_s
}
