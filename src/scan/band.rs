//! Height bands: which part of a 3D cloud a virtual scan is made of.

use std::cmp::Ordering;

use super::limits::RANGE_MAX_M;

/// Lowest limit of a band, metres above the floor, …
pub const BAND_LOWEST_M: f64 = -1.0;
/// … and highest.
pub const BAND_HIGHEST_M: f64 = 10.0;
/// Thinnest band, metres: thinner ones are within the noise of ranges and of the vehicle's attitude.
pub const BAND_THINNEST_M: f64 = 0.02;

/// Heights above the floor that a virtual scan is made of. Scans of different bands are different
/// layers: one is no evidence for or against another.
///
/// Bands are distinguished by both limits, and sorted from the lowest.
#[derive(Debug, Clone, Copy)]
pub struct HeightBand {
    /// Lower end, metres above the floor.
    pub from_m: f64,
    /// Upper end, metres above the floor.
    pub to_m: f64,
}

/// A band as a lidar sees it.
///
/// A lidar above or below a band sees it only from some distance on, and far away its rays are too far apart in
/// height. Between the two distances a scan can show that the band is free; elsewhere only hits count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BandView {
    /// The band.
    pub band: HeightBand,
    /// Nearest distance at which its scans show the band free, metres along the floor.
    pub clear_from_m: f64,
    /// Farthest such distance, metres.
    pub clear_to_m: f64,
}

/// Why a band is refused; the text explains it to the sender.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum BandError {
    /// A limit is not finite or not plausible.
    #[error(
        "a band lies within {BAND_LOWEST_M} m and {BAND_HIGHEST_M} m above the floor, not from \
         {from_m} to {to_m}: send metres above the floor, not above the lidar"
    )]
    Height {
        /// As sent.
        from_m: f64,
        /// As sent.
        to_m: f64,
    },
    /// Upside down, or too thin.
    #[error(
        "a band goes up by at least {BAND_THINNEST_M} m, not from {from_m} to {to_m} m above the \
         floor"
    )]
    Thin {
        /// As sent.
        from_m: f64,
        /// As sent.
        to_m: f64,
    },
    /// The distances between which free space is claimed make no sense.
    #[error(
        "clear_from {clear_from_m} must be at least 0 and below clear_to {clear_to_m}, and both at \
         most {RANGE_MAX_M} m: they are distances from the lidar along the floor"
    )]
    Clear {
        /// As sent.
        clear_from_m: f64,
        /// As sent.
        clear_to_m: f64,
    },
}

impl HeightBand {
    /// Checks the ends.
    ///
    /// # Errors
    /// [`BandError`] if they are not finite, not plausible, or not in order.
    pub fn new(from_m: f64, to_m: f64) -> Result<Self, BandError> {
        let heights = BAND_LOWEST_M..=BAND_HIGHEST_M;
        if !heights.contains(&from_m) || !heights.contains(&to_m) {
            return Err(BandError::Height { from_m, to_m });
        }
        if to_m - from_m < BAND_THINNEST_M {
            return Err(BandError::Thin { from_m, to_m });
        }
        Ok(Self { from_m, to_m })
    }

    /// Whether a height, metres above the floor, lies in it.
    pub fn contains(&self, height_m: f64) -> bool {
        (self.from_m..=self.to_m).contains(&height_m)
    }
}

impl BandView {
    /// A band that is seen from 0 to `range_max_m`.
    pub fn all_the_way(band: HeightBand, range_max_m: f64) -> Self {
        Self {
            band,
            clear_from_m: 0.0,
            clear_to_m: range_max_m,
        }
    }

    /// Checks band and distances.
    ///
    /// # Errors
    /// The first [`BandError`] that applies.
    pub fn validated(self) -> Result<Self, BandError> {
        let Self {
            band,
            clear_from_m,
            clear_to_m,
        } = self;
        HeightBand::new(band.from_m, band.to_m)?;
        if !(0.0 <= clear_from_m && clear_from_m < clear_to_m && clear_to_m <= RANGE_MAX_M) {
            return Err(BandError::Clear {
                clear_from_m,
                clear_to_m,
            });
        }
        Ok(self)
    }

    /// Whether its scans can show the band free at this distance from the lidar, metres.
    pub fn is_clear_at(&self, range_m: f64) -> bool {
        (self.clear_from_m..=self.clear_to_m).contains(&range_m)
    }
}

impl Ord for HeightBand {
    fn cmp(&self, other: &Self) -> Ordering {
        (self.from_m.total_cmp(&other.from_m)).then(self.to_m.total_cmp(&other.to_m))
    }
}

impl PartialOrd for HeightBand {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for HeightBand {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for HeightBand {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absurd_bands_are_refused() {
        assert!(HeightBand::new(0.1, 0.4).is_ok());
        assert!(HeightBand::new(-0.5, 0.0).is_ok());
        for (from_m, to_m) in [
            (f64::NAN, 0.4),
            (0.1, f64::INFINITY),
            (100.0, 400.0),
            (-3.0, 0.4),
        ] {
            let error = HeightBand::new(from_m, to_m).unwrap_err();
            assert!(matches!(error, BandError::Height { .. }), "{error}");
        }
        for (from_m, to_m) in [(0.4, 0.1), (0.4, 0.4), (0.4, 0.41)] {
            let error = HeightBand::new(from_m, to_m).unwrap_err();
            assert!(matches!(error, BandError::Thin { .. }), "{error}");
        }
    }

    #[test]
    fn distances_are_in_order() {
        let band = HeightBand::new(0.1, 0.4).unwrap();
        let view = |clear_from_m, clear_to_m| {
            BandView {
                band,
                clear_from_m,
                clear_to_m,
            }
            .validated()
        };
        assert!(view(0.0, 5.0).is_ok() && view(1.5, 5.0).is_ok());
        for (from_m, to_m) in [(-0.1, 5.0), (5.0, 5.0), (f64::NAN, 5.0), (0.0, 501.0)] {
            assert!(view(from_m, to_m).is_err(), "{from_m} {to_m}");
        }
    }

    #[test]
    fn bands_sort_from_the_lowest() {
        let band = |from_m, to_m| HeightBand::new(from_m, to_m).unwrap();
        let mut bands = [band(0.6, 1.0), band(0.1, 0.5), band(0.1, 0.4)];
        bands.sort_unstable();
        assert_eq!(bands, [band(0.1, 0.4), band(0.1, 0.5), band(0.6, 1.0)]);
    }
}
