//! Readings outside a lidar's range: their meaning, their number, and whether they are in millimetres.

use crate::ingest::body_error::{BatchProblem, Checked, refuse};
use crate::scan::{LaserScan, Reading};

/// Fewest readings to decide that they are millimetres.
const MILLIMETRES_MIN: u64 = 16;

/// Readings of a batch by kind; beams without a reading (null) are not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RangeCounts {
    /// From `range_min` to below `range_max`: measurements.
    pub within: u64,
    /// Of `range_max` or longer: no returns.
    pub above_range_max: u64,
    /// Below `range_min`, including 0 and less: invalid.
    pub below_range_min: u64,
    /// Those of `above_range_max` of which a thousandth would be in range and that do not repeat the reading
    /// before: a driver with one large number for no return repeats it.
    thousandfold: u64,
}

impl RangeCounts {
    /// Counts the readings of a scan, in metres; NaN for null.
    pub(super) fn add(&mut self, sent_m: &[f64], scan: &LaserScan) {
        let lidar = scan.lidar();
        let mut before_m = f64::NAN;
        for (beam, &range_m) in sent_m.iter().enumerate() {
            if range_m.is_nan() {
                continue;
            }
            match scan.reading(beam) {
                Reading::Range(_) => self.within += 1,
                Reading::Invalid => self.below_range_min += 1,
                Reading::NoReturn => {
                    self.above_range_max += 1;
                    let in_m = 1e-3 * range_m;
                    let is_within = (lidar.range_min_m..lidar.range_max_m).contains(&in_m);
                    self.thousandfold += u64::from(is_within && range_m != before_m);
                }
            }
            before_m = range_m;
        }
    }

    /// Refuses readings in millimetres: hardly any is in range, and a thousandth of most others would be. For
    /// uploads only: journalled batches are processed as they were accepted.
    ///
    /// # Errors
    /// [`BatchProblem::OutOfRange`] at the ranges of the first scan.
    pub fn check_units(&self) -> Checked<()> {
        let is_in_millimetres = self.thousandfold >= MILLIMETRES_MIN
            && 2 * self.thousandfold > self.above_range_max
            && 20 * self.within < self.thousandfold;
        if !is_in_millimetres {
            return Ok(());
        }
        let detail = format!(
            "{} of {} readings are of range_max or longer, and a thousandth of them would not be: \
             did you send millimetres? Ranges are metres",
            self.above_range_max,
            self.within + self.above_range_max + self.below_range_min,
        );
        refuse(BatchProblem::OutOfRange, "/scans/0/ranges", detail)
    }
}
