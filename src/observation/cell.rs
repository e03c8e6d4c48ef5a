//! A small piece of surface that observations are tested against.

use crate::geometry::Vector2;

/// A place with hits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Map frame, metres.
    pub centre: Vector2<f64>,
    /// Half the width of the cell, metres; 0 where the centre is the mean of its hits.
    pub half_width_m: f64,
    /// Unit normal of the surface, of either sign, if its surroundings are flat.
    pub normal: Option<Vector2<f64>>,
    /// Mean of the unit vectors from the cell to the lidars that hit it: of length 1 if all hit it from one
    /// direction. Zero if unknown.
    pub seen_from: Vector2<f64>,
}

impl Cell {
    /// A cell of a grid, without a known surface.
    pub fn of_grid(centre: Vector2<f64>, half_width_m: f64) -> Self {
        Self {
            centre,
            half_width_m,
            normal: None,
            seen_from: Vector2::zeros(),
        }
    }
}

/// A cell's normal is estimated from neighbours within this distance, metres.
const NORMAL_REACH_M: f64 = 0.16;
/// Fewest cells for a normal, the cell itself included.
const NORMAL_CELLS_MIN: usize = 3;
/// Largest ratio of the variances across and along a flat surface.
const FLATNESS_MAX: f64 = 0.15;
/// No cell counts for more hits than this in a normal.
const HITS_MAX: f64 = 10.0;

/// Gathers the hits of one cell.
#[derive(Debug, Clone, Copy, Default)]
pub struct CellBuilder {
    hits: u32,
    sum: Vector2<f64>,
    seen_from: Vector2<f64>,
}

impl CellBuilder {
    /// Adds a hit by a lidar at `eye`.
    pub fn add(&mut self, hit: &Vector2<f64>, eye: &Vector2<f64>) {
        let back = eye - hit;
        self.hits += 1;
        self.sum += hit;
        self.seen_from += back / back.norm().max(f64::MIN_POSITIVE);
    }

    /// Whether anything was added.
    pub fn is_hit(&self) -> bool {
        self.hits > 0
    }

    /// The mean of its hits, map frame, metres.
    pub fn mean(&self) -> Vector2<f64> {
        self.sum / f64::from(self.hits.max(1))
    }

    /// The cell, its normal from `neighbours` (the cell itself may be among them).
    pub fn build<'a>(&self, neighbours: impl Iterator<Item = &'a Self>) -> Cell {
        let centre = self.mean();
        Cell {
            centre,
            half_width_m: 0.0,
            normal: normal_at(&centre, neighbours),
            seen_from: self.seen_from / f64::from(self.hits.max(1)),
        }
    }
}

fn normal_at<'a>(
    centre: &Vector2<f64>,
    neighbours: impl Iterator<Item = &'a CellBuilder>,
) -> Option<Vector2<f64>> {
    let (mut cells, mut weight) = (0, 0.0);
    let (mut sum, mut xx, mut xy, mut yy) = (Vector2::zeros(), 0.0, 0.0, 0.0);
    for neighbour in neighbours {
        let offset = neighbour.mean() - centre;
        if offset.norm_squared() > NORMAL_REACH_M * NORMAL_REACH_M {
            continue;
        }
        let w = f64::from(neighbour.hits).min(HITS_MAX);
        cells += 1;
        weight += w;
        sum += w * offset;
        xx += w * offset.x * offset.x;
        xy += w * offset.x * offset.y;
        yy += w * offset.y * offset.y;
    }
    if cells < NORMAL_CELLS_MIN {
        return None;
    }
    let mean: Vector2<f64> = sum / weight;
    let half_trace = 0.5 * ((xx + yy) / weight - mean.norm_squared());
    let half_difference = 0.5 * ((xx - yy) / weight - (mean.x * mean.x - mean.y * mean.y));
    let product = xy / weight - mean.x * mean.y;
    let radius = half_difference.hypot(product);
    if half_trace - radius > FLATNESS_MAX * (half_trace + radius) {
        return None;
    }
    let along_rad = 0.5 * product.atan2(half_difference);
    let (sin, cos) = along_rad.sin_cos();
    Some(Vector2::new(-sin, cos))
}
