//! One validated sweep.

use std::sync::Arc;

use super::{BEAMS_MAX, Lidar};

/// One sweep of a lidar.
///
/// Ranges are held as whole ticks of [`Lidar::tick_m`], so that a scan from memory and the same
/// scan from the store are equal to the bit. A beam without a measurement (no return, too near,
/// too far) is tick 0: it is evidence of nothing, not of free space (REP-117).
#[derive(Debug, Clone, PartialEq)]
pub struct LaserScan {
    lidar: Arc<Lidar>,
    /// The lidar's, at hand for many looks.
    tick_m: f64,
    ticks: Vec<u16>,
}

/// Why a sweep was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ScanError {
    /// No beams, or too many.
    #[error("a scan has 1 to {BEAMS_MAX} beams, this one has {0}")]
    BeamCount(usize),
    /// The beams go round more than once.
    #[error("{beams} beams cover {covered_deg:.0}°, more than one turn: is angle_increment right?")]
    MoreThanOneTurn {
        /// Beams sent.
        beams: usize,
        /// Degrees between the first and the last.
        covered_deg: u32,
    },
}

impl LaserScan {
    /// Takes ranges in metres, `None` for no return. Values outside
    /// [`range_min_m`, `range_max_m`) and non-finite ones count as no return.
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
                (r / tick_m).round().clamp(1.0, f64::from(u16::MAX)) as u16
            }
            _ => 0,
        };
        let ticks = ranges_m.into_iter().map(to_tick).collect();
        Self::from_ticks(lidar, ticks)
    }

    /// Takes ranges in ticks, 0 for no return.
    ///
    /// # Errors
    /// [`ScanError`] if the number of beams does not fit the lidar.
    pub fn from_ticks(lidar: Arc<Lidar>, ticks: Vec<u16>) -> Result<Self, ScanError> {
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

    /// Ranges in ticks, 0 for no return.
    pub fn ticks(&self) -> &[u16] {
        &self.ticks
    }

    /// Number of beams.
    pub fn beam_count(&self) -> usize {
        self.ticks.len()
    }

    /// A beam's range, metres; `None` for no return.
    pub fn range_m(&self, beam: usize) -> Option<f64> {
        match self.ticks.get(beam) {
            Some(&ticks) if ticks > 0 => Some(f64::from(ticks) * self.tick_m),
            _ => None,
        }
    }

    /// All ranges in beam order, metres.
    pub fn ranges_m(&self) -> impl Iterator<Item = Option<f64>> + '_ {
        (0..self.beam_count()).map(|beam| self.range_m(beam))
    }

    /// Beams with a measurement.
    pub fn return_count(&self) -> usize {
        self.ticks.iter().filter(|&&t| t > 0).count()
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
        assert!((read[5].unwrap() - 20.0).abs() < 1e-9);
        assert_eq!(scan.return_count(), 2);
    }

    #[test]
    fn beams_must_fit_the_circle() {
        assert_eq!(LaserScan::new(lidar(), []), Err(ScanError::BeamCount(0)));
        assert!(LaserScan::new(lidar(), vec![None; 63]).is_ok());
        assert!(LaserScan::new(lidar(), vec![None; 65]).is_err());
    }
}
