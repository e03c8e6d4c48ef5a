//! Several keyframes in one frame.

use std::collections::BTreeSet;

use crate::geometry::{Pose2, Vector2};
use crate::ids::NodeId;
use crate::matching::{LikelihoodGrid, ReferenceCloud};
use crate::scan::SurfacePoint;

/// A search around a known place compares points up to this far away, metres.
pub(super) const SEARCH_REACH_M: f64 = 12.0;

/// The points round a trip's last keyframe with an index of neighbours, kept until the trip has
/// another.
#[derive(Default)]
pub(super) struct LocalCloud {
    last: Option<NodeId>,
    cloud: Option<ReferenceCloud>,
}

impl LocalCloud {
    /// Makes it that of the local map round node `last`.
    pub fn follow(&mut self, last: NodeId, local_map: &LocalMap<'_>) {
        if self.last != Some(last) {
            self.last = Some(last);
            self.cloud = ReferenceCloud::new(local_map.scans.iter().copied());
        }
    }

    /// The points; `None` if there are none.
    pub fn points(&self) -> Option<&ReferenceCloud> {
        self.cloud.as_ref()
    }
}

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

    /// The points in the common frame, no farther than `reach_m` from its origin, at most
    /// `count_max` evenly chosen ones.
    pub fn points_within(&self, reach_m: f64, count_max: usize) -> Vec<SurfacePoint> {
        let placed = self.scans.iter().flat_map(|(local_from_base, points)| {
            let to_local = local_from_base.to_transform();
            points.iter().map(move |point| SurfacePoint {
                position: to_local.apply(&point.position),
                normal: point.normal.map(|normal| to_local.turn(&normal)),
                ..*point
            })
        });
        let within: Vec<SurfacePoint> = placed.filter(|p| p.position.norm() <= reach_m).collect();
        evenly_chosen(&within, count_max).copied().collect()
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
        evenly_chosen(&kept, count_max).copied().collect()
    }
}

/// All of some things, or `count_max` of them, evenly chosen.
pub(super) fn evenly_chosen<T>(things: &[T], count_max: usize) -> impl Iterator<Item = &T> {
    let count = things.len().min(count_max);
    (0..count).map(move |k| &things[k * things.len() / count])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(positions: &[(f64, f64)]) -> Vec<SurfacePoint> {
        let point = |&(x, y): &(f64, f64)| SurfacePoint {
            position: Vector2::new(x, y),
            normal: None,
            beam: 0,
            range_m: 1.0,
        };
        positions.iter().map(point).collect()
    }

    #[test]
    fn the_first_point_of_each_square_is_kept_in_order() {
        let first = points(&[(0.05, 0.05), (0.08, 0.01), (-0.05, 0.05), (0.35, 0.0)]);
        let second = points(&[(0.06, 0.06), (5.0, 0.0)]);
        let moved = Pose2::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let map = LocalMap::new(vec![(Pose2::IDENTITY, &first), (moved, &second)]);
        let kept = map.thinned(0.1, f64::INFINITY, 100);
        // The second scan's first point is turned to (−0.06, 0.06), beside the third one.
        let expected = [(0.05, 0.05), (-0.05, 0.05), (0.35, 0.0), (0.0, 5.0)];
        assert_eq!(kept.len(), expected.len());
        for (kept, (x, y)) in kept.iter().zip(expected) {
            assert!((kept - Vector2::new(x, y)).norm() < 1e-12, "{kept}");
        }
        assert_eq!(map.thinned(0.1, 1.0, 100).len(), 3, "no farther than 1 m");
    }

    #[test]
    fn of_too_many_an_even_choice_is_kept() {
        let line: Vec<(f64, f64)> = (0..1_000)
            .map(|k| (0.05 + 0.1 * f64::from(k), 0.0))
            .collect();
        let line = points(&line);
        let map = LocalMap::new(vec![(Pose2::IDENTITY, &line)]);
        let kept = map.thinned(0.1, f64::INFINITY, 30);
        assert_eq!(kept.len(), 30);
        for pair in kept.windows(2) {
            let gap_m = pair[1].x - pair[0].x;
            assert!((3.2..3.5).contains(&gap_m), "{gap_m}");
        }
        assert!(kept[0].x < 0.1 && kept[29].x > 96.0);
        assert_eq!(map.thinned(0.1, f64::INFINITY, 1_000).len(), 1_000);
    }

    #[test]
    fn a_map_without_points_has_nothing_to_match() {
        let map = LocalMap::new(vec![(Pose2::IDENTITY, &[])]);
        assert!(map.grid(0.1, 3).is_none());
        assert!(map.thinned(0.1, f64::INFINITY, 10).is_empty());
    }
}
