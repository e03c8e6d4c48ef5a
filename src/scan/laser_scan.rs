//! One validated sweep.

use std::sync::Arc;

use super::{BEAMS_MAX, Lidar};

/// One sweep of a lidar.
///
/// Ranges are held as whole ticks of [`Lidar::tick_m`], so that a scan from memory and the same
/// scan from the store are equal to the bit. A beam without a return is tick 0, an invalid reading
/// (too near, not a number) the last tick; see [`Reading`].
#[derive(Debug, Clone, PartialEq)]
pub struct LaserScan {
    lidar: Arc<Lidar>,
    /// The lidar's tick length, cached for ray tests.
    tick_m: f64,
    ticks: Arc<[u16]>,
}

/// The reading of one beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading {
    /// A return at this range, metres.
    Range(f64),
    /// No return: nothing within the lidar's range, or a surface that reflected nothing.
    NoReturn,
    /// Invalid: nearer than the lidar can measure, or not a number.
    Invalid,
}

/// The tick of a beam without a return.
pub const NO_RETURN_TICK: u16 = 0;
/// The tick of an invalid reading; the longest range is one less.
pub const INVALID_TICK: u16 = u16::MAX;

/// Two measurements differ if they are apart by more than this many standard deviations, …
const DIFFERENCE_SIGMAS: f64 = 6.0;
/// … and more than this, metres.
const DIFFERENCE_MIN_M: f64 = 0.05;
/// Two scans differ if one beam in this many does.
const DIFFERING_ONE_IN: usize = 4;

/// Why a sweep was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ScanError {
    /// No beams, or too many.
    #[error("a scan has 1 to {BEAMS_MAX} beams, this one has {0}")]
    BeamCount(usize),
    /// The beams cover more than a full turn.
    #[error(
        "{beams} beams cover {covered_deg:.0}°, more than one turn: is angle_increment right, or did you send degrees?"
    )]
    MoreThanOneTurn {
        /// Beams sent.
        beams: usize,
        /// Degrees between the first and the last.
        covered_deg: u32,
    },
}

impl LaserScan {
    /// Takes ranges in metres, `None` for no return. Values from `range_max_m` on count as no
    /// return; those below `range_min_m` and what is not a number are invalid (REP-117).
    ///
    /// # Errors
    /// [`ScanError`] if the number of beams does not fit the lidar.
    pub fn new(
        lidar: Arc<Lidar>,
        ranges_m: impl IntoIterator<Item = Option<f64>>,
    ) -> Result<Self, ScanError> {
        let tick_m = lidar.tick_m();
        let to_tick = |range: Option<f64>| match range {
            Some(r) if r >= lidar.range_min_m && r < lidar.range_max_m => {
                (r / tick_m).round().clamp(1.0, f64::from(INVALID_TICK - 1)) as u16
            }
            Some(r) if r.is_nan() || r < lidar.range_min_m => INVALID_TICK,
            _ => NO_RETURN_TICK,
        };
        let ticks: Vec<u16> = ranges_m.into_iter().map(to_tick).collect();
        Self::from_ticks(lidar, ticks)
    }

    /// Takes ranges in ticks: 0 for no return, the last for an invalid reading.
    ///
    /// # Errors
    /// [`ScanError`] if the number of beams does not fit the lidar.
    pub fn from_ticks(lidar: Arc<Lidar>, ticks: impl Into<Arc<[u16]>>) -> Result<Self, ScanError> {
        let ticks = ticks.into();
        let beams = ticks.len();
        if !(1..=BEAMS_MAX).contains(&beams) {
            return Err(ScanError::BeamCount(beams));
        }
        let covered_rad = (beams - 1) as f64 * lidar.angle_increment_rad;
        if covered_rad > std::f64::consts::TAU * 1.001 {
            return Err(ScanError::MoreThanOneTurn {
                beams,
                covered_deg: covered_rad.to_degrees() as u32,
            });
        }
        Ok(Self {
            tick_m: lidar.tick_m(),
            lidar,
            ticks,
        })
    }

    /// The lidar that took it.
    pub fn lidar(&self) -> &Arc<Lidar> {
        &self.lidar
    }

    /// Length of a tick, metres.
    pub fn tick_m(&self) -> f64 {
        self.tick_m
    }

    /// Ranges in ticks: 0 for no return, the last for an invalid reading.
    pub fn ticks(&self) -> &[u16] {
        &self.ticks
    }

    /// Number of beams.
    pub fn beam_count(&self) -> usize {
        self.ticks.len()
    }

    /// The reading of a beam; invalid if there is no such beam.
    pub fn reading(&self, beam: usize) -> Reading {
        match self.ticks.get(beam) {
            None | Some(&INVALID_TICK) => Reading::Invalid,
            Some(&NO_RETURN_TICK) => Reading::NoReturn,
            Some(&ticks) => Reading::Range(f64::from(ticks) * self.tick_m),
        }
    }

    /// A beam's range, metres; `None` without one.
    pub fn range_m(&self, beam: usize) -> Option<f64> {
        match self.reading(beam) {
            Reading::Range(range_m) => Some(range_m),
            Reading::NoReturn | Reading::Invalid => None,
        }
    }

    /// All ranges in beam order, metres.
    pub fn ranges_m(&self) -> impl Iterator<Item = Option<f64>> + '_ {
        (0..self.beam_count()).map(|beam| self.range_m(beam))
    }

    /// All beams in the form of an upload, metres: `None` (null) without a return, 0 if invalid.
    pub fn uploaded_ranges_m(&self) -> impl Iterator<Item = Option<f64>> + '_ {
        (0..self.beam_count()).map(|beam| match self.reading(beam) {
            Reading::Range(range_m) => Some(range_m),
            Reading::NoReturn => None,
            Reading::Invalid => Some(0.0),
        })
    }

    /// Whether it differs from another scan of the lidar: a quarter of the beams measured in both differ. It was
    /// then taken elsewhere, or the world has changed.
    pub fn differs_from(&self, other: &Self) -> bool {
        let allowed_ticks =
            (DIFFERENCE_SIGMAS * self.lidar.range_sigma_m).max(DIFFERENCE_MIN_M) / self.tick_m;
        let measured = |tick: &u16| !matches!(*tick, NO_RETURN_TICK | INVALID_TICK);
        let pairs = self.ticks.iter().zip(other.ticks.iter());
        let pairs = pairs.filter(|(a, b)| measured(a) && measured(b));
        let (differing, both) = pairs.fold((0, 0), |(differing, both), (a, b)| {
            let differs = f64::from(a.abs_diff(*b)) > allowed_ticks;
            (differing + usize::from(differs), both + 1)
        });
        DIFFERING_ONE_IN * differing > both
    }

    /// Beams with a measurement.
    pub fn return_count(&self) -> usize {
        let measured = |tick: &&u16| !matches!(**tick, NO_RETURN_TICK | INVALID_TICK);
        self.ticks.iter().filter(measured).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;

    fn lidar() -> Arc<Lidar> {
        Arc::new(Lidar {
            angle_min_rad: 0.0,
            angle_increment_rad: 0.1,
            range_min_m: 0.05,
            range_max_m: 20.0,
            mount: Pose2::IDENTITY,
            range_sigma_m: 0.01,
            band: None,
        })
    }

    #[test]
    fn what_is_no_measurement_stays_none() {
        let ranges = [
            Some(1.2344),
            None,
            Some(0.01),
            Some(20.0),
            Some(f64::NAN),
            Some(19.9996),
        ];
        let scan = LaserScan::new(lidar(), ranges).unwrap();
        let read: Vec<_> = scan.ranges_m().collect();
        assert!((read[0].unwrap() - 1.234).abs() < 1e-9);
        assert_eq!(read[1..5], [None; 4]);
        let said: Vec<Reading> = (1..5).map(|beam| scan.reading(beam)).collect();
        use Reading::{Invalid, NoReturn};
        assert_eq!(said, [NoReturn, Invalid, NoReturn, Invalid]);
        assert!((read[5].unwrap() - 20.0).abs() < 1e-9);
        let uploaded: Vec<_> = scan.uploaded_ranges_m().collect();
        assert_eq!(uploaded[1..5], [None, Some(0.0), None, Some(0.0)]);
        let read_back = LaserScan::new(lidar(), uploaded).unwrap();
        assert_eq!(read_back.ticks()[..5], scan.ticks()[..5]);
        assert_eq!(scan.return_count(), 2);
    }

    #[test]
    fn beams_must_fit_the_circle() {
        assert_eq!(LaserScan::new(lidar(), []), Err(ScanError::BeamCount(0)));
        assert!(LaserScan::new(lidar(), vec![None; 63]).is_ok());
        assert!(LaserScan::new(lidar(), vec![None; 65]).is_err());
    }
}
