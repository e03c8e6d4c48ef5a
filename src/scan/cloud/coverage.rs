//! Where the rays of one direction leave a height band uncovered.

/// A ray in the upright plane of its direction, from the lidar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ray {
    /// How far it rises for each metre along the floor.
    pub slope: f64,
    /// Where it ended, metres along the floor.
    pub end_m: f64,
}

/// A height band in that plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slice {
    /// Its lower end, metres above the lidar.
    pub low_m: f64,
    /// Its upper end, metres above the lidar.
    pub high_m: f64,
    /// A gap between rays that is higher than this leaves it uncovered, metres.
    pub gap_max_m: f64,
}

impl Slice {
    /// How far the band is covered without a break, from one distance on and at most up to another,
    /// metres along the floor; the first distance if it is not covered there. Rays cover where they
    /// pass. Sorts the rays.
    pub fn free_to(&self, rays: &mut [Ray], from_m: f64, to_m: f64) -> f64 {
        let open = self.uncovered(rays, to_m).into_iter();
        let beyond = open.filter(|(_, open_to_m)| *open_to_m > from_m);
        let first_m = beyond
            .map(|(open_m, _)| open_m.max(from_m))
            .min_by(f64::total_cmp);
        first_m.unwrap_or(to_m)
    }

    /// The distances up to `to_m`, metres along the floor, at which a part of the band that is
    /// higher than the greatest gap has no ray; in no order. Sorts the rays.
    ///
    /// All rays come from one point, so that the one above stays above. Of two neighbours the gap
    /// within the band is the least of four straight lines over the distance, so that it is too
    /// high over one span. Neighbours change where a ray ends.
    pub fn uncovered(&self, rays: &mut [Ray], to_m: f64) -> Vec<(f64, f64)> {
        rays.sort_by(|a, b| a.slope.total_cmp(&b.slope));
        let count = rays.len();
        // Place 0 stands for what is below all rays, the last one for what is above.
        let mut below: Vec<usize> = (0..count + 2).map(|k| k.saturating_sub(1)).collect();
        let mut above: Vec<usize> = (1..count + 3).collect();
        let mut since_m = vec![0.0; count + 1];
        let slope = |place: usize| rays.get(place.wrapping_sub(1)).map(|ray| ray.slope);
        let mut open = Vec::new();
        let mut close = |lower: usize, upper: usize, from_m: f64, end_m: f64| {
            let span = self.too_high(slope(lower), slope(upper));
            let (from_m, end_m) = (span.0.max(from_m), span.1.min(end_m.min(to_m)));
            if from_m < end_m {
                open.push((from_m, end_m));
            }
        };
        let mut ending: Vec<usize> = (1..=count).collect();
        ending.sort_by(|a, b| rays[a - 1].end_m.total_cmp(&rays[b - 1].end_m));
        for ray in ending {
            let (end_m, lower, upper) = (rays[ray - 1].end_m, below[ray], above[ray]);
            close(lower, ray, since_m[lower], end_m);
            close(ray, upper, since_m[ray], end_m);
            (above[lower], below[upper]) = (upper, lower);
            since_m[lower] = end_m;
        }
        close(0, count + 1, since_m[0], to_m);
        open
    }

    /// Over which distances the gap between two neighbours, within the band, is too high; `None`
    /// where there is no ray below or above.
    fn too_high(&self, lower: Option<f64>, upper: Option<f64>) -> (f64, f64) {
        let mut span = (0.0_f64, f64::INFINITY);
        // Where slope · distance > height.
        let mut above = |slope: f64, height_m: f64| {
            let at_m = height_m / slope;
            if slope > 0.0 {
                span.0 = span.0.max(at_m);
            } else if slope < 0.0 {
                span.1 = span.1.min(at_m);
            } else if height_m >= 0.0 {
                span.1 = 0.0;
            }
        };
        if let Some(upper) = upper {
            above(upper, self.low_m + self.gap_max_m);
        }
        if let Some(lower) = lower {
            above(-lower, self.gap_max_m - self.high_m);
        }
        if let (Some(lower), Some(upper)) = (lower, upper) {
            above(upper - lower, self.gap_max_m);
        }
        span
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The highest part of the band without a ray at a distance, by looking at every ray.
    fn highest_gap(slice: &Slice, rays: &[Ray], at_m: f64) -> f64 {
        let passing = rays.iter().filter(|ray| ray.end_m > at_m);
        let mut heights: Vec<f64> = passing
            .map(|ray| ray.slope * at_m)
            .filter(|height_m| (slice.low_m..=slice.high_m).contains(height_m))
            .chain([slice.low_m, slice.high_m])
            .collect();
        heights.sort_by(f64::total_cmp);
        let gaps = heights.windows(2).map(|pair| pair[1] - pair[0]);
        gaps.fold(0.0, f64::max)
    }

    fn rays() -> impl Strategy<Value = Vec<Ray>> {
        let ray = (-0.8..0.8_f64, 0.1..9.0_f64).prop_map(|(slope, end_m)| Ray { slope, end_m });
        prop::collection::vec(ray, 0..24)
    }

    proptest! {
        #[test]
        fn spans_are_where_a_gap_is_too_high(
            rays in rays(), low_m in -1.0..0.8_f64, height_m in 0.1..0.8_f64,
            share in 0.05..0.95_f64, places in prop::collection::vec(0.001..8.0_f64, 40),
        ) {
            let slice = Slice { low_m, high_m: low_m + height_m, gap_max_m: share * height_m };
            let mut sorted = rays.clone();
            let open = slice.uncovered(&mut sorted, 8.0);
            for at_m in places {
                let is_open = open.iter().any(|(from_m, to_m)| *from_m < at_m && at_m < *to_m);
                let gap_m = highest_gap(&slice, &rays, at_m);
                if (gap_m - slice.gap_max_m).abs() > 1e-9 {
                    prop_assert_eq!(is_open, gap_m > slice.gap_max_m, "at {}: {}", at_m, gap_m);
                }
            }
        }

        #[test]
        fn the_way_that_is_free_ends_at_the_first_span(
            rays in rays(), from_m in 0.0..2.0_f64, way_m in 0.0..5.0_f64,
        ) {
            let slice = Slice { low_m: -0.3, high_m: 0.2, gap_max_m: 0.2 };
            let mut rays = rays;
            let free_to_m = slice.free_to(&mut rays, from_m, from_m + way_m);
            prop_assert!((from_m..=from_m + way_m).contains(&free_to_m));
            let steps = (1..200).map(|k| from_m + (free_to_m - from_m) * f64::from(k) / 200.0);
            for at_m in steps.filter(|_| free_to_m > from_m + 1e-9) {
                prop_assert!(highest_gap(&slice, &rays, at_m) <= slice.gap_max_m + 1e-9);
            }
            if free_to_m < from_m + way_m - 1e-6 {
                prop_assert!(highest_gap(&slice, &rays, free_to_m + 1e-7) > slice.gap_max_m - 1e-6);
            }
        }
    }
}
