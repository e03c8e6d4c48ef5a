//! Judges the beams of one scan by another one: the comparison in an alert's evidence.

use crate::geometry::Vector2;
use crate::model::BeamVerdict;
use crate::observation::{Cell, Observation, Outcome};

/// A beam with the verdict of another scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JudgedBeam {
    /// Where it ended, metres, in the frame of the scans' poses; `None` without a return.
    pub end: Option<Vector2<f64>>,
    /// The other scan's verdict.
    pub verdict: BeamVerdict,
}

/// Three neighbouring beams hit one surface if the outer ends are no farther apart, metres, …
const SURFACE_GAP_MAX_M: f64 = 0.5;
/// … and the middle end no farther from the line between them, metres.
const SURFACE_DEPTH_MAX_M: f64 = 0.05;

/// The verdict of the scan `by` on each beam of the scan `judged`, in beam order: its ray test of a cell at the
/// beam's end.
pub fn judge_beams(judged: &Observation, by: &Observation) -> Vec<JudgedBeam> {
    let ends: Vec<_> = (0..judged.scan().beam_count())
        .map(|beam| judged.end_of(beam))
        .collect();
    let judge = |beam: usize| {
        let end = ends[beam];
        let verdict = end.map_or(BeamVerdict::NoReturn, |end| {
            let back = judged.eye() - end;
            let cell = Cell {
                normal: normal_at(&ends, beam),
                seen_from: back / back.norm().max(f64::MIN_POSITIVE),
                ..Cell::of_grid(end, 0.0)
            };
            match by.test(&cell) {
                Outcome::Hit => BeamVerdict::Agrees,
                Outcome::Miss => BeamVerdict::Contradicts,
                _ if by.hides(&cell) => BeamVerdict::Occluded,
                Outcome::NoReturn | Outcome::Unknown => BeamVerdict::Unseen,
            }
        });
        JudgedBeam { end, verdict }
    };
    (0..ends.len()).map(judge).collect()
}

/// The normal of the surface that a beam hit, from the ends of its neighbours; `None` if they are not on one
/// surface.
fn normal_at(ends: &[Option<Vector2<f64>>], beam: usize) -> Option<Vector2<f64>> {
    let (before, end) = (ends[beam.checked_sub(1)?]?, ends[beam]?);
    let after = (*ends.get(beam + 1)?)?;
    let along = (after - before).try_normalize(f64::MIN_POSITIVE)?;
    let normal = Vector2::new(-along.y, along.x);
    let is_one = (after - before).norm() <= SURFACE_GAP_MAX_M
        && (end - before).dot(&normal).abs() <= SURFACE_DEPTH_MAX_M;
    is_one.then_some(normal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;
    use crate::scan::{LaserScan, Lidar};
    use proptest::prelude::*;
    use std::f64::consts::TAU;
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
            band: None,
        })
    }

    /// A round object: centre and radius, metres, map frame.
    type Pillar = (Vector2<f64>, f64);

    /// A full scan inside the square |x|, |y| ≤ 5 with pillars; beams towards +y of the map
    /// (within 10°) have no return.
    fn scan(map_from_base: &Pose2, pillars: &[Pillar]) -> LaserScan {
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
                let is_hit = beside2 < radius_m * radius_m && middle_m > 0.0;
                is_hit.then_some(middle_m - half_m)
            };
            let nearest = pillars.iter().filter_map(to_pillar);
            Some(nearest.fold(wall_m, f64::min))
        });
        LaserScan::new(lidar.clone(), ranges.collect::<Vec<_>>()).unwrap()
    }

    fn seen(map_from_base: &Pose2, pillars: &[Pillar]) -> Observation {
        Observation::new(&scan(map_from_base, pillars), map_from_base)
    }

    fn share(beams: &[JudgedBeam], verdict: BeamVerdict) -> f64 {
        let count = beams.iter().filter(|b| b.verdict == verdict).count();
        count as f64 / beams.len() as f64
    }

    #[test]
    fn an_appeared_pillar_contradicts_and_nothing_else_does() {
        let pillar: Pillar = (Vector2::new(2.0, -1.5), 0.3);
        let (old_at, new_at) = (Pose2::new(-1.0, 0.0, 0.2), Pose2::new(-0.4, 0.3, -0.3));
        let (old, new) = (seen(&old_at, &[]), seen(&new_at, &[pillar]));
        let of_new = judge_beams(&new, &old);
        let of_old = judge_beams(&old, &new);
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

    fn pose() -> impl Strategy<Value = Pose2> {
        (-2.0..2.0_f64, -2.0..2.0_f64, -3.1..3.1_f64).prop_map(|(x, y, t)| Pose2::new(x, y, t))
    }

    proptest! {
        #[test]
        fn a_scan_agrees_with_itself_wherever_it_is(a in pose()) {
            let observation = seen(&a, &[]);
            let judged = judge_beams(&observation, &observation);
            for beam in judged.iter().filter(|b| b.verdict != BeamVerdict::NoReturn) {
                let end = beam.end.unwrap();
                let beyond_m = (end - observation.eye()).norm() - observation.reach_m();
                // What lies on the edge of its reach may round to either side.
                if beyond_m.abs() > 1e-6 {
                    let is_within = beyond_m < 0.0;
                    let expected = if is_within { BeamVerdict::Agrees } else { BeamVerdict::Unseen };
                    prop_assert_eq!(beam.verdict, expected);
                }
                prop_assert!((end.x.abs().max(end.y.abs()) - 5.0).abs() < 2e-3, "{}", end);
            }
        }
    }
}
