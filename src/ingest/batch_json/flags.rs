//! What is odd about a batch but no reason to refuse it.

use jiff::Timestamp;

use crate::mapping::DriveScan;
use crate::model::BatchFlag;

/// Faster than any vehicle on a route, m/s.
const SPEED_MAX_M_PER_S: f64 = 50.0;
/// Stamps further in the future than this are a wrong clock, nanoseconds.
const SKEW_MAX_NS: i128 = 24 * 3_600 * 1_000_000_000;
/// Stamps older than this are late, nanoseconds.
const LATE_MIN_NS: i128 = 30 * SKEW_MAX_NS;

/// The flags in alphabetical order.
pub(super) fn flags(scans: &[DriveScan], received_at: Timestamp) -> Vec<String> {
    let age_ns = |scan: &DriveScan| received_at.as_nanosecond() - i128::from(scan.stamp.0);
    let flags = [
        (
            BatchFlag::ClockSkew,
            scans.iter().any(|s| age_ns(s) < -SKEW_MAX_NS),
        ),
        (
            BatchFlag::EmptyScans,
            scans.iter().any(|s| s.scan.return_count() == 0),
        ),
        (
            BatchFlag::Late,
            scans.iter().any(|s| age_ns(s) > LATE_MIN_NS),
        ),
        (BatchFlag::WildOdometry, scans.windows(2).any(is_wild)),
    ];
    let raised = flags.iter().filter(|(_, raised)| *raised);
    raised.map(|(flag, _)| flag.name().to_owned()).collect()
}

/// Those of them that stamps alone raise.
pub(in crate::ingest) fn clock_flags(stamps: &[Timestamp], received_at: Timestamp) -> Vec<String> {
    let age_ns = |stamp: &Timestamp| received_at.as_nanosecond() - stamp.as_nanosecond();
    let flags = [
        (
            BatchFlag::ClockSkew,
            stamps.iter().any(|s| age_ns(s) < -SKEW_MAX_NS),
        ),
        (
            BatchFlag::Late,
            stamps.iter().any(|s| age_ns(s) > LATE_MIN_NS),
        ),
    ];
    let raised = flags.iter().filter(|(_, raised)| *raised);
    raised.map(|(flag, _)| flag.name().to_owned()).collect()
}

fn is_wild(pair: &[DriveScan]) -> bool {
    let [before, after] = pair else { return false };
    let elapsed_s = (after.stamp.0 - before.stamp.0) as f64 * 1e-9;
    let motion = before.odom_from_base.between(&after.odom_from_base);
    motion.translation().norm() > SPEED_MAX_M_PER_S * elapsed_s
}
