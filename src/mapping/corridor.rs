//! Where a trip is along a corridor.
//!
//! What one scan shows of a corridor fits in many places along it: door frames are alike. What the
//! trip saw on its last metres fits in fewer. So the trip's local map is laid along the corridor onto
//! what references show, and closures begin where it fits.

use super::local_map::{LocalMap, SEARCH_REACH_M};
use super::partners::{self, Placed};
use crate::geometry::{Matrix2, Pose2, Vector2};
use crate::matching::{Alignment, IcpParams, ReferenceCloud, Termination};
use crate::scan::SurfacePoint;

/// A scan is of a corridor if its surfaces face one direction by no more than this share …
const FACING_SHARE_MAX: f64 = 0.2;
/// … and the local map by no more than this.
const LOCAL_FACING_SHARE_MAX: f64 = 0.3;
/// So long it is at least, as far as the trip has seen it, metres: a single wall is none.
pub(super) const SEEN_MIN_M: f64 = 6.0;
/// How far along the corridor it is looked for, metres.
const ALONG_MAX_M: f64 = 0.8;
/// So many points of the local map say as much as all.
const POINTS_MAX: usize = 500;
/// Least share of the local map that must fit.
const SUPPORT_MIN: f64 = 0.5;

/// Where a trip is (`map_from_base` of its newest keyframe, which has these points) that is expected
/// at `expected`, moved along the corridor that it is in; `local_map` makes one in the keyframe's
/// base frame, if it is needed.
///
/// `None` where there is no corridor, or where the references show another place.
pub(super) fn find_along<'a>(
    newest: &[SurfacePoint],
    local_map: impl FnOnce() -> LocalMap<'a>,
    references: &[Placed<'a>],
    expected: &Pose2,
    range_sigma_m: f64,
) -> Option<Pose2> {
    // Of the newest scan alone first: most are of no corridor.
    if least_faced(newest)?.0 >= FACING_SHARE_MAX {
        return None;
    }
    let points = local_map().points_within(SEARCH_REACH_M, POINTS_MAX);
    let (share, along) = least_faced(&points)?;
    if share >= LOCAL_FACING_SHARE_MAX || length_m(&points, &along) < SEEN_MIN_M {
        return None;
    }
    let nearest = partners::nearest_first(expected, references.iter().copied());
    let apart = partners::spaced(nearest, usize::MAX);
    let scans = apart
        .iter()
        .map(|placed| (placed.pose, placed.keyframe.points.as_slice()));
    let cloud = ReferenceCloud::new(scans)?;
    let mut alignment = Alignment::new(&cloud, &points);
    let params = &IcpParams::ROBUST;
    let axis = alignment.contrast(expected, params, &[]).axis;
    let start = alignment.best_along(expected, &axis, ALONG_MAX_M, params);
    let found = alignment.align_from(&start, range_sigma_m, None, params);
    if found.termination == Termination::TooFewPoints || found.explained_share() < SUPPORT_MIN {
        return None;
    }
    Some(moved_along(&axis, expected, &found.pose))
}

/// A pose moved along an axis of its own frame to beside another one.
fn moved_along(axis: &Vector2<f64>, from: &Pose2, to: &Pose2) -> Pose2 {
    let by_m = axis.dot(&from.between(to).translation());
    from.compose(&Pose2::new(by_m * axis.x, by_m * axis.y, 0.0))
}

/// The direction that surfaces face least (a unit vector), and how far they do: 0 if all are parallel
/// to it, a half if they face every direction alike. `None` without surfaces.
fn least_faced(points: &[SurfacePoint]) -> Option<(f64, Vector2<f64>)> {
    let normals = points.iter().filter_map(|point| point.normal);
    let (sum, count) = normals.fold((Matrix2::zeros(), 0.0), |(sum, count), n| {
        (sum + n * n.transpose(), count + 1.0)
    });
    let eigen = sum.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    (count > 0.0).then(|| {
        let direction = eigen.eigenvectors.column(least).into_owned();
        (eigen.eigenvalues[least] / count, direction)
    })
}

/// How far points reach along a direction, metres.
pub(super) fn length_m(points: &[SurfacePoint], along: &Vector2<f64>) -> f64 {
    let (first, last) = points
        .iter()
        .map(|point| along.dot(&point.position))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), at_m| {
            (first.min(at_m), last.max(at_m))
        });
    last - first
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::ids::{NodeId, StampNs, TripId};
    use crate::mapping::keyframe::Keyframe;
    use crate::scan::{LaserScan, Lidar};
    use crate::sim::{Shape, World};

    /// Walls to the left and to the right, 60 m long, with pillars along them.
    fn corridor(pillars: &[f64]) -> World {
        let wall = |y: f64| Shape::rectangle(&Pose2::new(0.0, y, 0.0), 60.0, 0.2);
        let pillar = |x: &f64| Shape::rectangle(&Pose2::new(*x, 1.1, 0.0), 0.15, 0.1);
        let pillars: Vec<Shape> = pillars.iter().map(pillar).collect();
        World::new([wall(-1.2), wall(1.2)].into_iter().chain(pillars))
    }

    /// Keyframes 1 m apart, the last one at x = 0.
    fn drive(world: &World) -> Vec<Keyframe> {
        let lidar = Arc::new(Lidar {
            angle_min_rad: -std::f64::consts::FRAC_PI_2,
            angle_increment_rad: std::f64::consts::PI / 360.0,
            range_min_m: 0.05,
            range_max_m: 10.0,
            mount: Pose2::IDENTITY,
            range_sigma_m: 0.01,
            band: None,
        });
        let keyframe = |k: i64| {
            let base = Pose2::new(k as f64 - 7.0, 0.0, 0.0);
            let ranges = (0..361).map(|beam| {
                let (sin, cos) = lidar.beam_angle_rad(beam).sin_cos();
                let hit = world.cast(&base.translation(), &Vector2::new(cos, sin))?;
                Some(hit.range_m).filter(|range_m| *range_m < 10.0)
            });
            let scan = LaserScan::new(lidar.clone(), ranges).unwrap();
            let trip = TripId::new("t").unwrap();
            Keyframe::new(NodeId(k), trip, StampNs(k), base, scan)
        };
        (0..8).map(keyframe).collect()
    }

    /// Where a drive is found that is expected `off_m` too far along.
    fn found(world: &World, off_m: f64) -> Option<Pose2> {
        let keyframes = drive(world);
        let placed = |k: &'_ usize| Placed {
            pose: keyframes[*k].odom_from_base,
            keyframe: &keyframes[*k],
        };
        let references: Vec<Placed<'_>> = (0..8).collect::<Vec<_>>().iter().map(placed).collect();
        let scans = keyframes
            .iter()
            .map(|keyframe| (keyframe.odom_from_base, keyframe.points.as_slice()));
        let local_map = LocalMap::new(scans.collect());
        let expected = Pose2::new(off_m, 0.0, 0.0);
        find_along(
            &keyframes[7].points,
            || local_map,
            &references,
            &expected,
            0.01,
        )
    }

    #[test]
    fn pillars_tell_the_place_along_a_corridor() {
        let world = corridor(&[-6.0, -3.3, -1.1, 2.7, 4.0]);
        for off_m in [-0.6, -0.4, 0.4, 0.6] {
            let found = found(&world, off_m).unwrap();
            assert!(found.x.abs() < 0.03, "{off_m}: {}", found.x);
            assert!(found.y.abs() < 0.01 && found.theta.abs() < 0.01);
        }
    }

    #[test]
    fn along_a_bare_corridor_it_is_where_it_was_expected() {
        let found = found(&corridor(&[]), 0.4).unwrap();
        assert!((found.x - 0.4).abs() < 0.01, "{}", found.x);
    }

    #[test]
    fn a_room_is_no_corridor() {
        let corners = [(-9.0, -4.0), (5.0, -4.0), (5.0, 4.0), (-9.0, 4.0)];
        let corners = corners.map(|(x, y)| Vector2::new(x, y));
        assert!(found(&World::new([Shape::Outline(corners.into())]), 0.2).is_none());
    }
}
