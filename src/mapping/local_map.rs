//! Several keyframes in one frame.

use std::collections::BTreeSet;

use crate::geometry::{Pose2, Vector2};
use crate::matching::{LikelihoodGrid, ReferenceCloud};
use crate::scan::SurfacePoint;

/// A search around a known place compares points up to this far away, metres.
pub(super) const SEARCH_REACH_M: f64 = 12.0;

/// Keyframes placed in a common frame.
#[derive(Clone)]
pub(super) struct LocalMap<'a> {
    scans: Vec<(Pose2, &'a [SurfacePoint])>,
}

impl<'a> LocalMap<'a> {
    /// Of keyframes with `local_from_base`.
    pub fn new(scans: Vec<(Pose2, &'a [SurfacePoint])>) -> Self {
        Self { scans }
    }

    /// The points with an index of neighbours; `None` if there are none.
    pub fn cloud(&self) -> Option<ReferenceCloud> {
        ReferenceCloud::new(self.scans.iter().copied())
    }

    /// The points drawn for a search; `None` if there are none.
    pub fn grid(&self, resolution_m: f64, levels: usize) -> Option<LikelihoodGrid> {
        LikelihoodGrid::new(self.positions(), resolution_m, 1.5 * resolution_m, levels)
    }

    /// The points in a square around a place, drawn for a search; `None` if there are none.
    pub fn grid_around(
        &self,
        centre: &Vector2<f64>,
        half_width_m: f64,
        resolution_m: f64,
        levels: usize,
    ) -> Option<LikelihoodGrid> {
        let within = |p: &Vector2<f64>| (p - centre).amax() <= half_width_m;
        let near = self.positions().filter(within);
        LikelihoodGrid::new(near, resolution_m, 1.5 * resolution_m, levels)
    }

    fn positions(&self) -> impl Iterator<Item = Vector2<f64>> + Clone + '_ {
        self.scans.iter().flat_map(|(local_from_base, points)| {
            let to_local = local_from_base.to_transform();
            points.iter().map(move |p| to_local.apply(&p.position))
        })
    }

    /// One point for each square of the given width, in order of appearance, no farther than
    /// `reach_m` from the frame's origin, at most `count_max` evenly chosen ones: what a search
    /// compares.
    pub fn thinned(&self, width_m: f64, reach_m: f64, count_max: usize) -> Vec<Vector2<f64>> {
        let mut taken = BTreeSet::new();
        let mut kept = Vec::new();
        for position in self.positions().filter(|p| p.norm() <= reach_m) {
            let cell = (
                (position.x / width_m).floor() as i64,
                (position.y / width_m).floor() as i64,
            );
            if taken.insert(cell) {
                kept.push(position);
            }
        }
        if kept.len() <= count_max {
            return kept;
        }
        (0..count_max)
            .map(|k| kept[k * kept.len() / count_max])
            .collect()
    }
}
