//! The points a scan is matched against.

use pulp::Simd;

use super::point_grid::{Found, Neighbour, PointGrid};
use crate::geometry::{Pose2, Vector2};
use crate::scan::SurfacePoint;

/// Points with normals in one frame, with an index of nearest neighbours.
pub struct ReferenceCloud {
    grid: PointGrid,
    /// In the order of the grid.
    normals: Vec<Option<Vector2<f64>>>,
}

impl ReferenceCloud {
    /// Gathers scans; each comes with `reference_from_base`. `None` if there is no point at all.
    pub fn new<'a>(scans: impl IntoIterator<Item = (Pose2, &'a [SurfacePoint])>) -> Option<Self> {
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        for (reference_from_base, points) in scans {
            let to_reference = reference_from_base.to_transform();
            for point in points {
                positions.push(to_reference.apply(&point.position));
                normals.push(point.normal.map(|n| to_reference.turn(&n)));
            }
        }
        let (grid, order) = PointGrid::new(&positions)?;
        let normals = order.iter().map(|&k| normals[k as usize]).collect();
        Some(Self { grid, normals })
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.normals.len()
    }

    /// Never: a cloud has points.
    pub fn is_empty(&self) -> bool {
        self.normals.is_empty()
    }

    /// The nearest point within a distance.
    pub fn nearest(&self, point: &Vector2<f64>, distance_max_m: f64) -> Option<Neighbour> {
        self.grid
            .nearest(pulp::Scalar::new(), point, distance_max_m, None)
            .nearest
    }

    /// The same, sooner found if a point near the nearest one is known.
    #[inline(always)]
    pub(super) fn nearest_from<S: Simd>(
        &self,
        simd: S,
        point: &Vector2<f64>,
        distance_max_m: f64,
        near: Option<usize>,
    ) -> Found {
        self.grid.nearest(simd, point, distance_max_m, near)
    }

    /// Calls back with every point within a distance, and with some that are a little farther away.
    pub(super) fn around(&self, point: &Vector2<f64>, distance_m: f64, take: impl FnMut(usize)) {
        self.grid.around(point, distance_m, take);
    }

    /// A point's position, metres.
    #[inline]
    pub fn position(&self, index: usize) -> Vector2<f64> {
        self.grid.position(index)
    }

    /// A point's unit normal; `None` at corners and lone points.
    #[inline]
    pub fn normal(&self, index: usize) -> Option<Vector2<f64>> {
        self.normals[index]
    }
}
