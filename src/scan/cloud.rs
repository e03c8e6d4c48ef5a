//! Virtual scans of height bands, from the cloud of a 3D lidar.
//!
//! Each range of a 2D lidar states two things: something is there, and nothing is in front of it. For a height
//! band of a cloud only the first is obvious. Where the band is free follows from the rays: each passes through
//! it at one height, over the distances at which it is neither below nor above it. [`BandScanner`] computes
//! that ray by ray.

mod coverage;

use std::f64::consts::TAU;
use std::sync::Arc;

use self::coverage::{Ray, Slice};
use super::{
    BEAMS_MAX, BandError, BandView, HeightBand, LaserScan, Lidar, LidarError, RANGE_MAX_M,
    ScanError,
};
use crate::geometry::{Pose2, Vector2};

/// Margin for rings that are not exactly evenly spaced: free space is claimed only where they are closer
/// together by this share than necessary.
const COVERAGE_MARGIN: f64 = 0.8;
/// A return this far above or below the lidar for each metre beside it is a ray straight up or
/// down, which says nothing of a direction.
const SLOPE_MAX: f64 = 1e6;
/// Lengths that differ by less are the same, metres.
const SAME_M: f64 = 1e-6;

/// A 3D lidar on a vehicle that stands level.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudLidar {
    /// `base_from_lidar`, seen from above.
    pub mount: Pose2,
    /// Height above the floor, metres.
    pub height_m: f64,
    /// Elevations of its rings above the horizontal, radians, in any order.
    pub elevations_rad: Vec<f64>,
    /// Beams of a virtual scan, evenly spread over the full turn: no more than the lidar has rays in
    /// a ring, or some stay empty.
    pub beams: usize,
    /// Returns that are nearer than this, along the floor, are no hits, metres; positive.
    pub range_min_m: f64,
    /// Largest range, metres.
    pub range_max_m: f64,
    /// Standard deviation of a range, metres.
    pub range_sigma_m: f64,
}

/// Why no virtual scans can be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CloudError {
    /// The height of the lidar is not finite.
    #[error("the lidar's height {0} is not a height above the floor in metres")]
    Height(f64),
    /// An elevation is not within ±π/2.
    #[error("the elevation {0} of a ring is not within ±π/2: did you send degrees?")]
    Elevation(f64),
    /// The virtual scan has no beams, or too many.
    #[error("a virtual scan has 8 to {BEAMS_MAX} beams, not {0}")]
    Beams(usize),
    /// Nothing nearer than the lidar's own housing can be distinguished from no measurement.
    #[error("range_min {0} must be positive: what is nearer than it says nothing")]
    RangeMin(f64),
    /// The least height is not a part of the band.
    #[error("least_height {least_height_m} must be positive and less than the band's {band_m} m")]
    LeastHeight {
        /// As given.
        least_height_m: f64,
        /// Height of the band, metres.
        band_m: f64,
    },
    /// Nowhere are the rings close enough.
    #[error(
        "nowhere do the rings see all of the band from {from_m} to {to_m} m so closely that nothing \
         {least_height_m} m high slips between them: raise least_height, or choose a band that the \
         lidar looks at"
    )]
    NeverSeen {
        /// Of the band.
        from_m: f64,
        /// Of the band.
        to_m: f64,
        /// As given.
        least_height_m: f64,
    },
    /// The band is refused.
    #[error(transparent)]
    Band(#[from] BandError),
    /// The virtual lidar is refused.
    #[error(transparent)]
    Lidar(#[from] LidarError),
}

impl CloudLidar {
    /// A point of the base frame (x, y and height above the floor, metres) as
    /// [`BandScanner::scan`] wants it: from the lidar, in its directions, metres.
    pub fn from_base(&self, [x, y, height_m]: [f64; 3]) -> [f64; 3] {
        let in_lidar = self.mount.inverse().transform(&Vector2::new(x, y));
        [in_lidar.x, in_lidar.y, height_m - self.height_m]
    }

    fn check(&self) -> Result<(), CloudError> {
        if !self.height_m.is_finite() {
            return Err(CloudError::Height(self.height_m));
        }
        let is_elevation = |e: &&f64| e.abs() < 0.25 * TAU;
        if let Some(elevation) = self.elevations_rad.iter().find(|e| !is_elevation(e)) {
            return Err(CloudError::Elevation(*elevation));
        }
        if !(8..=BEAMS_MAX).contains(&self.beams) {
            return Err(CloudError::Beams(self.beams));
        }
        if self.range_min_m.is_nan() || self.range_min_m <= 0.0 {
            return Err(CloudError::RangeMin(self.range_min_m));
        }
        Ok(())
    }
}

/// Makes virtual scans of one height band.
///
/// What a beam of such a scan says, of the rays whose direction, seen from above, lies in its part
/// of the turn:
///
/// - *A range* is the distance along the floor of the nearest return within the band. It says that
///   something is there, and that the band is free before it.
/// - *No return*: there is no return within the band, and it is free.
/// - *Invalid*: neither is known.
///
/// *Free* means: at every distance the rays that pass there, and end farther away, leave no gap
/// within the band that is higher than `least_height_m`. A thing that is higher than this within the
/// band, and as wide as the beam, would have stopped one of them. What is thinner, as the top of a
/// table is, may have slipped between two rings; whoever wants to find it chooses a smaller
/// `least_height_m`, and pays with reach. A ray without a return proves nothing, nor does one that
/// ends on a low thing before it has come up to the band.
///
/// A lidar that is above or below the band sees it only from some distance on; far away its rings
/// are too far apart. Both distances follow from the rings alone: they are
/// [`clear_from_m`](BandView::clear_from_m) and [`clear_to_m`](BandView::clear_to_m) of the scans'
/// lidar. "Free" is proven, and claimed, between them alone; a hit is reported wherever it is.
///
/// ```
/// use mapshift::geometry::Pose2;
/// use mapshift::scan::{BandScanner, CloudLidar, HeightBand, Reading};
///
/// // Sixteen rings, two degrees apart, 0.8 m above the floor.
/// let lidar = CloudLidar {
///     mount: Pose2::new(0.2, 0.0, 0.0),
///     height_m: 0.8,
///     elevations_rad: (0..16).map(|ring| f64::from(2 * ring - 15).to_radians()).collect(),
///     beams: 360,
///     range_min_m: 0.3,
///     range_max_m: 30.0,
///     range_sigma_m: 0.02,
/// };
/// let band = HeightBand::new(0.6, 1.0)?;
/// let scanner = BandScanner::new(&lidar, band, 0.15)?;
///
/// // A wall 4 m before the lidar and 2.5 m high, as the rings that look ahead see it: those that
/// // look far down meet the floor before it. All others see nothing.
/// let cloud = lidar.elevations_rad.iter().map(|elevation| {
///     let rise = elevation.tan();
///     let to_floor_m = if rise < 0.0 { -lidar.height_m / rise } else { f64::INFINITY };
///     let way_m = to_floor_m.min(4.0);
///     [way_m, 0.0, way_m * rise]
/// });
/// let scan = scanner.scan(cloud)?;
/// assert_eq!(scan.reading(180), Reading::Range(4.0));
/// assert_eq!(scan.reading(0), Reading::Invalid);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct BandScanner {
    lidar: Arc<Lidar>,
    beams: usize,
    slice: Slice,
}

impl BandScanner {
    /// For a lidar and a band above the floor. Free space is claimed where nothing that is higher than
    /// `least_height_m` within the band can have slipped between the rays, metres.
    ///
    /// # Errors
    /// [`CloudError`] if lidar, band or height are absurd, or if the rings never see the band so
    /// closely.
    pub fn new(
        lidar: &CloudLidar,
        band: HeightBand,
        least_height_m: f64,
    ) -> Result<Self, CloudError> {
        lidar.check()?;
        let band = HeightBand::new(band.from_m, band.to_m)?;
        let band_m = band.to_m - band.from_m;
        if !(least_height_m > 0.0 && least_height_m < band_m) {
            return Err(CloudError::LeastHeight {
                least_height_m,
                band_m,
            });
        }
        let slice = Slice {
            low_m: band.from_m - lidar.height_m,
            high_m: band.to_m - lidar.height_m,
            gap_max_m: least_height_m,
        };
        let (clear_from_m, clear_to_m) =
            clear_distances(lidar, &slice).ok_or(CloudError::NeverSeen {
                from_m: band.from_m,
                to_m: band.to_m,
                least_height_m,
            })?;
        let virtual_lidar = Lidar {
            angle_min_rad: -0.5 * TAU,
            angle_increment_rad: TAU / lidar.beams as f64,
            range_min_m: lidar.range_min_m,
            range_max_m: lidar.range_max_m,
            mount: lidar.mount,
            range_sigma_m: lidar.range_sigma_m,
            band: Some(BandView {
                band,
                clear_from_m,
                clear_to_m,
            }),
        };
        Ok(Self {
            lidar: Arc::new(virtual_lidar.validated()?),
            beams: lidar.beams,
            slice,
        })
    }

    /// The lidar of its scans.
    pub fn lidar(&self) -> &Arc<Lidar> {
        &self.lidar
    }

    /// The virtual scan of a cloud: the points at which rays ended, from the lidar, in its
    /// directions (x, y, and z upwards), metres. What is not finite is no return. Returns on the
    /// vehicle itself are to be left out. Cost: points, sorted beam by beam.
    ///
    /// # Errors
    /// [`ScanError`] never, since the beams were checked.
    pub fn scan(&self, cloud: impl IntoIterator<Item = [f64; 3]>) -> Result<LaserScan, ScanError> {
        let mut of_beams: Vec<Vec<Ray>> = vec![Vec::new(); self.beams];
        for [x, y, z] in cloud {
            let end_m = x.hypot(y);
            let slope = z / end_m;
            // What is not finite fails too.
            if slope.abs() <= SLOPE_MAX && end_m <= RANGE_MAX_M {
                of_beams[self.beam_towards(y.atan2(x))].push(Ray { slope, end_m });
            }
        }
        let ranges_m = of_beams.iter_mut().map(|rays| self.reading(rays));
        LaserScan::new(self.lidar.clone(), ranges_m)
    }

    /// The beam into whose part of the turn a direction falls.
    fn beam_towards(&self, direction_rad: f64) -> usize {
        let turns = (direction_rad - self.lidar.angle_min_rad) / self.lidar.angle_increment_rad;
        turns.round() as usize % self.beams
    }

    /// What a beam says, as [`LaserScan::new`] takes it: not a number if it says nothing.
    fn reading(&self, rays: &mut [Ray]) -> Option<f64> {
        let Some(view) = self.lidar.band else {
            return Some(f64::NAN);
        };
        let band = self.slice.low_m..=self.slice.high_m;
        let is_hit = |ray: &&Ray| {
            ray.end_m >= self.lidar.range_min_m && band.contains(&(ray.slope * ray.end_m))
        };
        let hits_m = rays.iter().filter(is_hit).map(|ray| ray.end_m);
        let nearest_m = hits_m.min_by(f64::total_cmp);
        let claimed_to_m = nearest_m.unwrap_or(f64::INFINITY).min(view.clear_to_m);
        let proven_to_m = self.slice.free_to(rays, view.clear_from_m, claimed_to_m);
        match proven_to_m + SAME_M >= claimed_to_m {
            true => nearest_m,
            false => Some(f64::NAN),
        }
    }
}

/// Between which distances the rings, if nothing is in their way, lie close enough: the longest
/// such way.
fn clear_distances(lidar: &CloudLidar, slice: &Slice) -> Option<(f64, f64)> {
    let rays = lidar.elevations_rad.iter().map(|elevation| {
        let slope = elevation.tan();
        let to_floor_m = match slope < 0.0 && lidar.height_m > 0.0 {
            true => -lidar.height_m / slope,
            false => f64::INFINITY,
        };
        let end_m = to_floor_m.min(lidar.range_max_m * elevation.cos());
        Ray { slope, end_m }
    });
    let stricter = Slice {
        gap_max_m: COVERAGE_MARGIN * slice.gap_max_m,
        ..*slice
    };
    let mut open = stricter.uncovered(&mut rays.collect::<Vec<_>>(), lidar.range_max_m);
    open.sort_by(|a, b| a.0.total_cmp(&b.0));
    open.push((lidar.range_max_m, lidar.range_max_m));
    let mut longest: Option<(f64, f64)> = None;
    let mut covered_from_m = 0.0;
    for (from_m, to_m) in open {
        let is_longest = longest.is_none_or(|(a, b)| from_m - covered_from_m > b - a);
        if from_m - covered_from_m > SAME_M && is_longest {
            longest = Some((covered_from_m, from_m));
        }
        covered_from_m = to_m.max(covered_from_m);
    }
    longest
}

#[cfg(test)]
mod tests;
