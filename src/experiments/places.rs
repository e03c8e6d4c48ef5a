//! Where an object can be drawn: free and observed in the original recordings.

use std::collections::HashMap;

use super::placed::PlacedScan;
use crate::geometry::Vector2;
use crate::ids::StampNs;
use crate::sim::Shape;

/// No scan hits anything within this distance of an object's middle, metres, …
pub(super) const CLEAR_M: f64 = 0.3;
/// … or within this of its outline.
pub(super) const OUTLINE_CLEAR_M: f64 = 0.1;
/// The robot keeps this distance from an object, metres.
const PATH_M: f64 = 0.35;
/// This many scans must see the place before the object's moment, and as many after.
pub(super) const SEEN_MIN: usize = 8;
/// A scan sees a place if this many of its beams go through the object and end behind it. A beam without a
/// return does not count: it may have hit something dark in front.
const BEAMS_MIN: usize = 3;
const CELL_M: f64 = 0.5;

/// The observations of the original recordings.
pub(super) struct Places<'a> {
    pub scans: &'a [PlacedScan<'a>],
    hits: HashMap<(i64, i64), Vec<Vector2<f64>>>,
}

impl<'a> Places<'a> {
    pub(super) fn of(scans: &'a [PlacedScan<'a>]) -> Self {
        let mut hits: HashMap<_, Vec<_>> = HashMap::new();
        for hit in scans.iter().flat_map(PlacedScan::hits) {
            hits.entry(cell_of(&hit)).or_default().push(hit);
        }
        Self { scans, hits }
    }

    /// Whether no scan has a hit in an object or near it, and the robot keeps away from it.
    pub(super) fn is_free(&self, shape: &Shape) -> bool {
        let (middle, radius_m) = shape.bounding_circle();
        let reach_m = CLEAR_M.max(radius_m + OUTLINE_CLEAR_M);
        let corner = |sign: f64| cell_of(&(middle + Vector2::new(sign, sign) * reach_m));
        let (low, high) = (corner(-1.0), corner(1.0));
        let cells = (low.0..=high.0).flat_map(|x| (low.1..=high.1).map(move |y| (x, y)));
        let hit = cells
            .filter_map(|cell| self.hits.get(&cell))
            .flatten()
            .any(|hit| {
                (hit - middle).norm() <= CLEAR_M || distance_m(shape, hit) <= OUTLINE_CLEAR_M
            });
        !hit && self.scans.iter().all(|placed| {
            let ways = [&placed.map_from_base, &placed.map_from_lidar];
            ways.into_iter()
                .all(|pose| distance_m(shape, &pose.translation()) >= PATH_M)
        })
    }

    /// Whether enough scans before a moment and since it see an object's place.
    pub(super) fn is_seen(&self, shape: &Shape, moment: StampNs) -> bool {
        let (mut before, mut since) = (0, 0);
        for placed in self.scans {
            let count = match placed.scan.stamp < moment {
                true => &mut before,
                false => &mut since,
            };
            if *count < SEEN_MIN {
                *count += usize::from(sees(placed, shape));
            }
        }
        before >= SEEN_MIN && since >= SEEN_MIN
    }
}

/// Whether enough beams of a scan pass through an object.
fn sees(placed: &PlacedScan<'_>, shape: &Shape) -> bool {
    let (middle, radius_m) = shape.bounding_circle();
    let passing = placed
        .beams_towards(&middle, radius_m)
        .into_iter()
        .filter(|&beam| placed.scan.ranges_m[beam].is_some())
        .filter(|&beam| entry_m(placed, beam, shape).is_some());
    passing.take(BEAMS_MIN).count() == BEAMS_MIN
}

/// Where a beam that would pass through an object enters it, metres from the lidar, also if it has
/// no return; `None` if it misses the object or ends before.
pub(super) fn entry_m(placed: &PlacedScan<'_>, beam: usize, shape: &Shape) -> Option<f64> {
    let angle_rad = placed.map_from_lidar.theta + placed.lidar.beam_angle_rad(beam);
    let direction = Vector2::new(angle_rad.cos(), angle_rad.sin());
    let eye = placed.map_from_lidar.translation();
    let entry_m = shape.distance_along(&eye, &direction)?;
    let in_reach = (placed.lidar.range_min_m..placed.lidar.range_max_m).contains(&entry_m);
    let nearer = placed.scan.ranges_m[beam].is_none_or(|range_m| entry_m < range_m);
    (in_reach && nearer).then_some(entry_m)
}

/// From a solid shape to a point, metres.
pub(super) fn distance_m(shape: &Shape, point: &Vector2<f64>) -> f64 {
    if shape.contains(point) {
        0.0
    } else {
        shape.distance_to(point)
    }
}

fn cell_of(point: &Vector2<f64>) -> (i64, i64) {
    let cell = |v: f64| (v / CELL_M).floor() as i64;
    (cell(point.x), cell(point.y))
}
