//! What one scan sees at a point: the comparison that tells a changed world from a bad match.

use std::f64::consts::TAU;

use crate::geometry::{Pose2, Transform2, Vector2, direction_rad, wrap_angle};
use crate::scan::{LaserScan, SurfacePoint};

/// Beams that graze a surface more than this, as the cosine of the angle to its normal, are taken
/// to graze it by this: 78°.
const INCIDENCE_COS_MIN: f64 = 0.2;

/// What a scan says about a point; of several scans from one place the greatest holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Visibility {
    /// Outside the field of view, or the beam has no return: no evidence.
    Unseen,
    /// The beam ended before it.
    Occluded,
    /// The beam passed through the point and went on.
    Free,
    /// The beam ended there.
    Surface,
}

/// What a scan says about another's points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Agreement {
    /// Points where a beam ended.
    pub surface: usize,
    /// Points that a beam passed through.
    pub free: usize,
    /// Points behind the end of a beam.
    pub occluded: usize,
    /// Points without evidence.
    pub unseen: usize,
}

impl Agreement {
    /// Share of the points in reach that the scan contradicts, in [0, 1].
    pub fn contradiction_share(&self) -> f64 {
        self.free as f64 / (self.free + self.surface).max(1) as f64
    }
}

/// A scan, made ready for many looks.
pub struct View<'a> {
    scan: &'a LaserScan,
    lidar_from_base: Transform2,
    /// Direction of the first beam, in (−π, π].
    first_beam_rad: f64,
    beams_per_rad: f64,
    /// Whether the last beam is the first one's neighbour.
    goes_round: bool,
}

impl<'a> View<'a> {
    /// Of a scan.
    pub fn new(scan: &'a LaserScan) -> Self {
        let lidar = scan.lidar();
        // Half a beam for rounding; a gap of a whole beam is a gap.
        let covered_rad = (scan.beam_count() as f64 + 0.5) * lidar.angle_increment_rad;
        Self {
            scan,
            lidar_from_base: lidar.mount.inverse().to_transform(),
            first_beam_rad: wrap_angle(lidar.angle_min_rad),
            beams_per_rad: 1.0 / lidar.angle_increment_rad,
            goes_round: covered_rad >= TAU,
        }
    }

    /// What the scan says about a point of its base frame.
    ///
    /// Nearer than the lidar measures a point is unseen: some lidars look through what stands
    /// there. Beside a depth edge the beam and its neighbours are taken together: a point is free
    /// only before the nearest of them, occluded only behind the farthest. `tolerance_m` is the
    /// distance by which two views of one surface may differ: along the beam, or across the surface
    /// if its unit `normal` in the base frame is given, which is more along a beam that grazes it.
    pub fn look_at(
        &self,
        point: &Vector2<f64>,
        normal: Option<&Vector2<f64>>,
        tolerance_m: f64,
    ) -> Visibility {
        let in_lidar = self.lidar_from_base.apply(point);
        let range_m = in_lidar.norm();
        let Some(beam) = self.beam_towards(&in_lidar) else {
            return Visibility::Unseen;
        };
        let Some(own_m) = self.scan.range_m(beam) else {
            return Visibility::Unseen;
        };
        let lidar = self.scan.lidar();
        if !(lidar.range_min_m..lidar.range_max_m).contains(&range_m) {
            return Visibility::Unseen;
        }
        let incidence_cos = normal.map_or(1.0, |normal| {
            let across = self.lidar_from_base.turn(normal);
            (in_lidar.dot(&across) / range_m).abs()
        });
        let depth_m = tolerance_m / incidence_cos.max(INCIDENCE_COS_MIN);
        let (mut least_m, mut most_m) = (own_m, own_m);
        let beside = self.beams_beside(beam).into_iter();
        for neighbour_m in beside.filter_map(|b| self.scan.range_m(b)) {
            least_m = least_m.min(neighbour_m);
            most_m = most_m.max(neighbour_m);
        }
        if range_m < least_m - depth_m {
            match lidar.is_clear_at(range_m) {
                true => Visibility::Free,
                false => Visibility::Unseen,
            }
        } else if range_m > most_m + depth_m {
            Visibility::Occluded
        } else {
            Visibility::Surface
        }
    }

    /// The beams on both sides, across the seam of a full turn too; one that is not there is
    /// beyond the last.
    fn beams_beside(&self, beam: usize) -> [usize; 2] {
        let count = self.scan.beam_count();
        let across = |seam: usize| if self.goes_round { seam } else { count };
        let before = if beam > 0 {
            beam - 1
        } else {
            across(count - 1)
        };
        let after = if beam + 1 < count {
            beam + 1
        } else {
            across(0)
        };
        [before, after]
    }

    fn beam_towards(&self, in_lidar: &Vector2<f64>) -> Option<usize> {
        let turn_rad = direction_rad(in_lidar) - self.first_beam_rad;
        let beams = turn_rad * self.beams_per_rad;
        let beams_per_turn = self.beams_per_rad * TAU;
        // Half a beam before the first is still its own.
        let beams = if beams < -0.5 {
            beams + beams_per_turn
        } else if beams >= beams_per_turn - 0.5 {
            beams - beams_per_turn
        } else {
            beams
        };
        let beam = (beams + 0.5) as usize;
        (beam < self.scan.beam_count()).then_some(beam)
    }
}

/// What the lidars of a vehicle saw at one time, each from where it was.
pub struct Views<'a> {
    own: View<'a>,
    /// Each with `its_base_from_base`.
    others: Vec<(Transform2, View<'a>)>,
}

impl<'a> Views<'a> {
    /// Of one scan alone.
    pub fn new(scan: &'a LaserScan) -> Self {
        Self {
            own: View::new(scan),
            others: Vec::new(),
        }
    }

    /// And of others, each with `base_from_its_base`: the base may have moved in between.
    #[must_use]
    pub fn with(mut self, others: impl Iterator<Item = (Pose2, &'a LaserScan)>) -> Self {
        let view =
            |(pose, scan): (Pose2, &'a LaserScan)| (pose.inverse().to_transform(), View::new(scan));
        self.others.extend(others.map(view));
        self
    }

    /// What they say about a point of the base frame, as [`View::look_at`]: it is a surface if one
    /// of them ended there, else free if one passed through it.
    pub fn look_at(
        &self,
        point: &Vector2<f64>,
        normal: Option<&Vector2<f64>>,
        tolerance_m: f64,
    ) -> Visibility {
        let by_others = self.others.iter().map(|(to_its, view)| {
            let normal = normal.map(|normal| to_its.turn(normal));
            view.look_at(&to_its.apply(point), normal.as_ref(), tolerance_m)
        });
        let own = self.own.look_at(point, normal, tolerance_m);
        by_others.fold(own, Visibility::max)
    }
}

/// By how much two views of one surface may differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthTolerance {
    /// Metres, beside what the turn error makes of the range (3 σ).
    pub depth_m: f64,
    /// Turn error, radians.
    pub sigma_theta_rad: f64,
    /// Whether it is meant across the surface: along a beam that grazes it views differ by more.
    pub is_across: bool,
}

/// What the scans `seen_by` say about the points of another place.
pub fn agreement(
    points: &[SurfacePoint],
    seen_by: &Views<'_>,
    seen_by_from_points: &Pose2,
    tolerance: &DepthTolerance,
) -> Agreement {
    let mut counts = Agreement::default();
    let to_seen_by = seen_by_from_points.to_transform();
    for point in points {
        let position = to_seen_by.apply(&point.position);
        let turned_m = 3.0 * tolerance.sigma_theta_rad * position.norm();
        let allowed_m = tolerance.depth_m + turned_m;
        let normal = point.normal.filter(|_| tolerance.is_across);
        let normal = normal.map(|normal| to_seen_by.turn(&normal));
        match seen_by.look_at(&position, normal.as_ref(), allowed_m) {
            Visibility::Unseen => counts.unseen += 1,
            Visibility::Free => counts.free += 1,
            Visibility::Surface => counts.surface += 1,
            Visibility::Occluded => counts.occluded += 1,
        }
    }
    counts
}
