//! The points a scan is matched against.

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::geometry::{Pose2, Vector2};
use crate::scan::SurfacePoint;

/// Points with normals in one frame, with an index of nearest neighbours.
pub struct ReferenceCloud {
    positions: Vec<[f64; 2]>,
    normals: Vec<Option<Vector2<f64>>>,
    tree: ImmutableKdTree<f64, 2>,
}

impl ReferenceCloud {
    /// Gathers scans; each comes with `reference_from_base`. `None` if there is no point at all.
    pub fn new<'a>(scans: impl IntoIterator<Item = (Pose2, &'a [SurfacePoint])>) -> Option<Self> {
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        for (reference_from_base, points) in scans {
            let to_reference = reference_from_base.to_transform();
            for point in points {
                let position = to_reference.apply(&point.position);
                positions.push([position.x, position.y]);
                normals.push(point.normal.map(|n| to_reference.turn(&n)));
            }
        }
        if positions.is_empty() {
            return None;
        }
        let tree = ImmutableKdTree::new_from_slice(&positions).ok()?;
        Some(Self {
            positions,
            normals,
            tree,
        })
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Never: a cloud has points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Index of the nearest point within a distance.
    pub fn nearest(&self, point: &Vector2<f64>, distance_max_m: f64) -> Option<usize> {
        let found = self
            .tree
            .query(&[point.x, point.y])
            .nearest_one::<SquaredEuclidean<f64>>()
            .execute();
        (found.distance <= distance_max_m * distance_max_m).then_some(found.item as usize)
    }

    /// A point's position, metres.
    pub fn position(&self, index: usize) -> Vector2<f64> {
        Vector2::from(self.positions[index])
    }

    /// A point's unit normal; `None` at corners and lone points.
    pub fn normal(&self, index: usize) -> Option<Vector2<f64>> {
        self.normals[index]
    }

    /// All positions, metres.
    pub fn positions(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        self.positions.iter().map(|p| Vector2::from(*p))
    }
}
