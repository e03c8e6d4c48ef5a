//! A grid of how likely a lidar return is, with its pyramid of maxima.

use crate::geometry::Vector2;

/// Values 0–255 over square cells: 255 where a reference point lies, falling with the distance
/// to the nearest one; level h holds the maximum over windows of 2ʰ × 2ʰ cells that start at the
/// cell (Hess et al. 2016, section V-B).
pub struct LikelihoodGrid {
    resolution_m: f64,
    origin: Vector2<f64>,
    width: usize,
    height: usize,
    levels: Vec<Vec<u8>>,
}

/// The kernel reaches so many standard deviations.
const KERNEL_SIGMAS: f64 = 3.0;
/// Most cells; a larger map gets a coarser grid.
const CELLS_MAX: f64 = 16e6;

impl LikelihoodGrid {
    /// Draws points, metres, with a Gaussian kernel. `None` if there are none.
    pub fn new(
        points: impl Iterator<Item = Vector2<f64>> + Clone,
        resolution_m: f64,
        sigma_m: f64,
        levels: usize,
    ) -> Option<Self> {
        let (mut low, mut high) = (
            Vector2::repeat(f64::INFINITY),
            Vector2::repeat(f64::NEG_INFINITY),
        );
        for point in points.clone() {
            low = low.inf(&point);
            high = high.sup(&point);
        }
        if low.x > high.x {
            return None;
        }
        let margin = Vector2::repeat(KERNEL_SIGMAS * sigma_m + resolution_m);
        let origin = low - margin;
        let size = high - low + margin * 2.0;
        let coarser = (size.x * size.y / (resolution_m * resolution_m) / CELLS_MAX).sqrt();
        let resolution_m = resolution_m * coarser.max(1.0);
        let width = (size.x / resolution_m) as usize + 1;
        let height = (size.y / resolution_m) as usize + 1;
        let mut grid = Self {
            resolution_m,
            origin,
            width,
            height,
            levels: Vec::with_capacity(levels),
        };
        grid.levels.push(grid.draw(points, sigma_m));
        for level in 1..levels {
            let coarse = grid.widen(level);
            grid.levels.push(coarse);
        }
        Some(grid)
    }

    fn draw(&self, points: impl Iterator<Item = Vector2<f64>>, sigma_m: f64) -> Vec<u8> {
        let reach = (KERNEL_SIGMAS * sigma_m / self.resolution_m).ceil() as i64;
        let side = (2 * reach + 1) as usize;
        let kernel: Vec<u8> = (0..side * side)
            .map(|k| {
                let (dx, dy) = ((k % side) as i64 - reach, (k / side) as i64 - reach);
                let distance_m = ((dx * dx + dy * dy) as f64).sqrt() * self.resolution_m;
                (255.0 * (-0.5 * (distance_m / sigma_m).powi(2)).exp()) as u8
            })
            .collect();
        let mut cells = vec![0u8; self.width * self.height];
        let mut marked = vec![false; self.width * self.height];
        for point in points {
            let (cx, cy) = self.cell_of(&point);
            let centre = (cy * self.width as i64 + cx) as usize;
            if std::mem::replace(&mut marked[centre], true) {
                continue;
            }
            for dy in -reach..=reach {
                let y = cy + dy;
                if y < 0 || y >= self.height as i64 {
                    continue;
                }
                for dx in -reach..=reach {
                    let x = cx + dx;
                    if x < 0 || x >= self.width as i64 {
                        continue;
                    }
                    let value = kernel[((dy + reach) * side as i64 + dx + reach) as usize];
                    let cell = &mut cells[(y * self.width as i64 + x) as usize];
                    *cell = value.max(*cell);
                }
            }
        }
        cells
    }

    /// Level h from level h − 1: windows start up to 2ʰ − 1 cells before the grid, so a cell is
    /// the maximum of its own place in the level below and of those 2ʰ⁻¹ cells before it.
    fn widen(&self, level: usize) -> Vec<u8> {
        let half = 1usize << (level - 1);
        let (width_below, height_below) = self.level_size(level - 1);
        let (width, height) = self.level_size(level);
        let below = &self.levels[level - 1];
        let mut cells = vec![0u8; width * height];
        for (y, row) in below.chunks_exact(width_below).enumerate() {
            for target in [y, y + half] {
                let out = &mut cells[target * width..(target + 1) * width];
                raise(&mut out[..width_below], row);
                raise(&mut out[half..half + width_below], row);
            }
        }
        debug_assert_eq!(height, height_below + half);
        cells
    }

    #[inline]
    fn level_size(&self, level: usize) -> (usize, usize) {
        let extra = (1usize << level) - 1;
        (self.width + extra, self.height + extra)
    }

    /// Number of levels.
    pub fn level_count(&self) -> usize {
        self.levels.len()
    }

    /// Edge of a cell, metres.
    pub fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// Width and height, metres.
    pub fn size_m(&self) -> Vector2<f64> {
        Vector2::new(self.width as f64, self.height as f64) * self.resolution_m
    }

    /// The middle, metres.
    pub fn centre(&self) -> Vector2<f64> {
        self.origin + self.size_m() * 0.5
    }

    /// The cell of a position; outside the grid too.
    pub fn cell_of(&self, position: &Vector2<f64>) -> (i64, i64) {
        let scaled = (position - self.origin) / self.resolution_m;
        (scaled.x.floor() as i64, scaled.y.floor() as i64)
    }

    /// The maximum over the window of 2ˡᵉᵛᵉˡ cells that starts at a cell; 0 outside.
    #[inline]
    pub fn value(&self, level: usize, x: i64, y: i64) -> u8 {
        let (width, height) = self.level_size(level);
        let extra = (1i64 << level) - 1;
        // A cell before the first is far beyond the last.
        let (x, y) = ((x + extra) as usize, (y + extra) as usize);
        if x >= width || y >= height {
            return 0;
        }
        self.levels[level][y * width + x]
    }
}

fn raise(cells: &mut [u8], to: &[u8]) {
    for (cell, &value) in cells.iter_mut().zip(to) {
        *cell = value.max(*cell);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_level_is_the_maximum_over_its_window(
            points in proptest::collection::vec((-2.0..2.0_f64, -2.0..2.0_f64), 1..12),
            level in 1usize..5, x in -20i64..60, y in -20i64..60,
        ) {
            let points: Vec<_> = points.into_iter().map(|(x, y)| Vector2::new(x, y)).collect();
            let grid = LikelihoodGrid::new(points.iter().copied(), 0.1, 0.1, 5).unwrap();
            let side = 1i64 << level;
            let brute = (0..side * side).map(|k| grid.value(0, x + k % side, y + k / side)).max();
            prop_assert_eq!(Some(grid.value(level, x, y)), brute);
        }
    }
}
