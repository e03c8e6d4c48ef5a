//! What a scan says of another's beams, one by one: the comparison behind an alert's evidence.

use crate::geometry::{Pose2, Vector2};
use crate::matching::{View, Visibility};
use crate::scan::LaserScan;

/// What another scan says of a beam.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BeamVerdict {
    /// The other scan has a surface where the beam ended.
    Agrees,
    /// The other scan saw through the place where the beam ended.
    Contradicts,
    /// Something nearer hid the place from the other scan.
    Occluded,
    /// The other scan did not look there, or its beam has no return.
    Unseen,
    /// The beam itself has no return: nothing to judge, and no evidence of free space (REP-117).
    NoReturn,
}

/// A beam and what another scan says of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JudgedBeam {
    /// Where it ended, metres, in the frame of the scans' poses; `None` without a return.
    pub end: Option<Vector2<f64>>,
    /// What the other scan says.
    pub verdict: BeamVerdict,
}

/// A scan and where it was taken.
#[derive(Debug, Clone, Copy)]
pub struct PlacedScan<'a> {
    /// `map_from_base`.
    pub map_from_base: Pose2,
    /// What was seen.
    pub scan: &'a LaserScan,
}

/// How far the depths of one surface may differ between two scans.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthTolerance {
    /// At range 0, metres.
    pub depth_m: f64,
    /// Standard deviation of the turn between the scans, radians; three of them count.
    pub sigma_theta_rad: f64,
}

impl DepthTolerance {
    /// What two matched scans are compared with when a closure is checked.
    pub const MATCHED: Self = Self {
        depth_m: 0.15,
        sigma_theta_rad: 0.005,
    };

    /// At a distance from the base, metres.
    pub fn at(&self, distance_m: f64) -> f64 {
        self.depth_m + 3.0 * self.sigma_theta_rad * distance_m
    }
}

/// What the scan `by` says of each beam of the scan `judged`, in beam order.
pub fn judge_beams(
    judged: &PlacedScan<'_>,
    by: &PlacedScan<'_>,
    tolerance: &DepthTolerance,
) -> Vec<JudgedBeam> {
    let lidar = judged.scan.lidar();
    let base_from_lidar = lidar.mount.to_transform();
    let map_from_base = judged.map_from_base.to_transform();
    let by_from_base = by
        .map_from_base
        .between(&judged.map_from_base)
        .to_transform();
    let view = View::new(by.scan);
    let judge = |(beam, range): (usize, Option<f64>)| {
        let Some(range_m) = range else {
            return JudgedBeam {
                end: None,
                verdict: BeamVerdict::NoReturn,
            };
        };
        let (sin, cos) = lidar.beam_angle_rad(beam).sin_cos();
        let in_base = base_from_lidar.apply(&Vector2::new(range_m * cos, range_m * sin));
        let seen_by = by_from_base.apply(&in_base);
        let verdict = match view.look_at(&seen_by, tolerance.at(seen_by.norm())) {
            Visibility::Surface => BeamVerdict::Agrees,
            Visibility::Free => BeamVerdict::Contradicts,
            Visibility::Occluded => BeamVerdict::Occluded,
            Visibility::Unseen => BeamVerdict::Unseen,
        };
        JudgedBeam {
            end: Some(map_from_base.apply(&in_base)),
            verdict,
        }
    };
    judged.scan.ranges_m().enumerate().map(judge).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::agreement;
    use crate::scan::{Lidar, surface_points};
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, TAU};
    use std::sync::Arc;

    const BEAMS: usize = 360;

    fn lidar() -> Arc<Lidar> {
        Arc::new(Lidar {
            angle_min_rad: -std::f64::consts::PI,
            angle_increment_rad: TAU / BEAMS as f64,
            range_min_m: 0.05,
            range_max_m: 12.0,
            mount: Pose2::new(0.2, -0.1, 0.4),
            range_sigma_m: 0.01,
        })
    }

    /// A round object: centre and radius, metres, map frame.
    type Pillar = (Vector2<f64>, f64);

    /// A look round inside the square |x|, |y| ≤ 5 with pillars; beams towards +y of the map
    /// (within 10°) have no return.
    fn look(map_from_base: &Pose2, pillars: &[Pillar]) -> LaserScan {
        let lidar = lidar();
        let eye = map_from_base.compose(&lidar.mount);
        let ranges = (0..BEAMS).map(|beam| {
            let angle_rad = eye.theta + lidar.beam_angle_rad(beam);
            let along = Vector2::new(angle_rad.cos(), angle_rad.sin());
            if along.y > 10_f64.to_radians().cos() {
                return None;
            }
            let to_wall = |p: f64, d: f64| (5.0_f64.copysign(d) - p) / d;
            let wall_m = to_wall(eye.x, along.x).min(to_wall(eye.y, along.y));
            let to_pillar = |(centre, radius_m): &Pillar| {
                let towards = centre - eye.translation();
                let middle_m = towards.dot(&along);
                let beside2 = towards.norm_squared() - middle_m * middle_m;
                let half_m = (radius_m * radius_m - beside2).max(0.0).sqrt();
                let struck = beside2 < radius_m * radius_m && middle_m > 0.0;
                struck.then_some(middle_m - half_m)
            };
            let nearest = pillars.iter().filter_map(to_pillar);
            Some(nearest.fold(wall_m, f64::min))
        });
        LaserScan::new(lidar.clone(), ranges.collect::<Vec<_>>()).unwrap()
    }

    fn placed(map_from_base: Pose2, scan: &LaserScan) -> PlacedScan<'_> {
        PlacedScan {
            map_from_base,
            scan,
        }
    }

    fn share(beams: &[JudgedBeam], verdict: BeamVerdict) -> f64 {
        let count = beams.iter().filter(|b| b.verdict == verdict).count();
        count as f64 / beams.len() as f64
    }

    #[test]
    fn an_appeared_pillar_contradicts_and_nothing_else_does() {
        let pillar: Pillar = (Vector2::new(2.0, -1.5), 0.3);
        let (old_at, new_at) = (Pose2::new(-1.0, 0.0, 0.2), Pose2::new(-0.4, 0.3, -0.3));
        let (old, new) = (look(&old_at, &[]), look(&new_at, &[pillar]));
        let tolerance = DepthTolerance::MATCHED;
        let of_new = judge_beams(&placed(new_at, &new), &placed(old_at, &old), &tolerance);
        let of_old = judge_beams(&placed(old_at, &old), &placed(new_at, &new), &tolerance);
        let contradicting = of_new
            .iter()
            .filter(|b| b.verdict == BeamVerdict::Contradicts);
        let ends: Vec<_> = contradicting.filter_map(|b| b.end).collect();
        assert!(ends.len() >= 6, "{ends:?}");
        for end in ends {
            let off_m = ((end - pillar.0).norm() - pillar.1).abs();
            assert!(off_m < 2e-3, "{end} is not on the pillar");
        }
        // What the old scan saw behind the pillar is hidden from the new one, not contradicted.
        assert_eq!(share(&of_old, BeamVerdict::Contradicts), 0.0);
        assert!(share(&of_old, BeamVerdict::Occluded) > 0.01);
        // The beams without a return are counted as such, and so is what they hide.
        assert!(
            of_new
                .iter()
                .all(|b| { (b.verdict == BeamVerdict::NoReturn) == b.end.is_none() })
        );
        assert!(share(&of_new, BeamVerdict::NoReturn) > 0.04);
        assert!(share(&of_new, BeamVerdict::Unseen) > 0.0);
        assert!(share(&of_new, BeamVerdict::Agrees) > 0.8);
    }

    #[test]
    fn the_tolerance_decides() {
        // The wall ahead has moved by 0.2 m, seen from 5 m and from 4.8 m.
        let degree = 1_f64.to_radians();
        let lidar = Arc::new(Lidar {
            angle_min_rad: -5.0 * degree,
            angle_increment_rad: degree,
            range_min_m: 0.05,
            range_max_m: 10.0,
            mount: Pose2::new(0.0, 0.0, FRAC_PI_2),
            range_sigma_m: 0.01,
        });
        let wall = |y: f64| {
            let range = |k| Some(y / lidar.beam_angle_rad(k).cos());
            LaserScan::new(lidar.clone(), (0..11).map(range)).unwrap()
        };
        let (far, near) = (wall(5.0), wall(4.8));
        let at = Pose2::new(3.0, -2.0, 1.0);
        for (sigma_theta_rad, verdict) in
            [(0.0, BeamVerdict::Contradicts), (0.01, BeamVerdict::Agrees)]
        {
            let tolerance = DepthTolerance {
                depth_m: 0.15,
                sigma_theta_rad,
            };
            let judged = judge_beams(&placed(at, &near), &placed(at, &far), &tolerance);
            assert!(judged.iter().all(|b| b.verdict == verdict), "{verdict:?}");
        }
        assert!((DepthTolerance::MATCHED.at(10.0) - 0.3).abs() < 1e-12);
    }

    fn pose() -> impl Strategy<Value = Pose2> {
        (-2.0..2.0_f64, -2.0..2.0_f64, -3.1..3.1_f64).prop_map(|(x, y, t)| Pose2::new(x, y, t))
    }

    proptest! {
        #[test]
        fn counts_are_those_of_the_closure_check(a in pose(), b in pose(), x in -3.0..3.0_f64) {
            let pillar: Pillar = (Vector2::new(x, 3.0), 0.4);
            let (old, new) = (look(&a, &[]), look(&b, &[pillar]));
            let tolerance = DepthTolerance::MATCHED;
            let judged = judge_beams(&placed(b, &new), &placed(a, &old), &tolerance);
            let counts = agreement(&surface_points(&new), &old, &a.between(&b), 0.15, 0.005);
            let count = |verdict| judged.iter().filter(|j| j.verdict == verdict).count();
            prop_assert_eq!(count(BeamVerdict::Agrees), counts.surface);
            prop_assert_eq!(count(BeamVerdict::Contradicts), counts.free);
            prop_assert_eq!(count(BeamVerdict::Occluded), counts.occluded);
            prop_assert_eq!(count(BeamVerdict::Unseen), counts.unseen);
            prop_assert_eq!(judged.len(), BEAMS);
        }

        #[test]
        fn a_scan_agrees_with_itself_wherever_it_is(a in pose()) {
            let scan = look(&a, &[]);
            let placed = placed(a, &scan);
            let judged = judge_beams(&placed, &placed, &DepthTolerance::MATCHED);
            for beam in judged.iter().filter(|b| b.verdict != BeamVerdict::NoReturn) {
                prop_assert_eq!(beam.verdict, BeamVerdict::Agrees);
                let end = beam.end.unwrap();
                prop_assert!((end.x.abs().max(end.y.abs()) - 5.0).abs() < 2e-3, "{}", end);
            }
        }
    }
}
