//! Readings outside a lidar's range: what they count as, how many there are, and whether they are in
//! another unit than metres.

use crate::ingest::body_error::{BatchProblem, Checked, refuse};
use crate::scan::{LaserScan, Reading};

/// So many readings are needed to say that they are millimetres.
const MILLIMETRES_MIN: u64 = 16;

/// Readings of a batch by what they count as; beams without a reading (null) are not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RangeCounts {
    /// From `range_min` to below `range_max`: measurements.
    pub within: u64,
    /// Of `range_max` or longer: no returns.
    pub above_range_max: u64,
    /// Below `range_min`, 0 and less included: they say nothing.
    pub below_range_min: u64,
    /// Those of `above_range_max` that a thousandth of would be within, and that are no repetition of
    /// the reading before: a driver that has one large number for no return repeats it.
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

    /// Refuses readings that are in millimetres: hardly a measurement, and most of the rest would be
    /// one. For uploads alone: what the journal holds already is processed as it was taken.
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
