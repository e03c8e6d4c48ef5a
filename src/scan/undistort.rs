//! Removes the motion of the lidar from a sweep.

use std::f64::consts::TAU;

use super::laser_scan::{INVALID_TICK, NO_RETURN_TICK};
use super::{LaserScan, Reading};
use crate::geometry::{Pose2, direction_rad, wrap_angle};

/// A base that moves by less during a sweep is stationary: metres and radians.
const STANDING_M: f64 = 1e-3;
const STANDING_RAD: f64 = 5e-4;
/// Two beams hit one surface if their ends are no farther apart than this share of their range, or …
const SURFACE_SHARE: f64 = 0.1;
/// … than this, metres.
const SURFACE_M: f64 = 0.1;

/// In which order the beams of a sweep are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SweepOrder {
    /// Counter-clockwise.
    FirstBeamFirst,
    /// Clockwise.
    LastBeamFirst,
}

/// A beam without the motion: its true direction in the frame of the sweep's beginning, and its reading.
#[derive(Clone, Copy)]
struct Turned {
    direction_rad: f64,
    reading: Reading,
}

impl LaserScan {
    /// The sweep as it would be from the pose at its beginning, if the base moved by `start_from_end` until its
    /// end, at constant speed.
    ///
    /// The end of every beam is transformed into that frame, and the result is interpolated between neighbours.
    /// Directions without a beam are invalid. A lidar that turns faster than it scans is left as it is.
    #[must_use]
    pub fn undistorted(&self, start_from_end: &Pose2, order: SweepOrder) -> Self {
        let moved_m = start_from_end.translation().norm();
        let is_standing = moved_m < STANDING_M && start_from_end.theta.abs() < STANDING_RAD;
        let beams = self.beam_count();
        if is_standing || beams < 2 {
            return self.clone();
        }
        let turned = self.turned(start_from_end, order);
        if !turned.is_sorted_by(|a, b| a.direction_rad < b.direction_rad) {
            return self.clone();
        }
        let lidar = self.lidar();
        let covered_rad = (beams as f64 + 0.5) * lidar.angle_increment_rad;
        let turns: &[f64] = match covered_rad >= TAU {
            true => &[0.0, TAU, -TAU],
            false => &[0.0],
        };
        let ticks = (0..beams).map(|beam| {
            let direction_rad = lidar.beam_angle_rad(beam);
            let readings = turns
                .iter()
                .map(|turn| reading_at(&turned, direction_rad + turn, lidar.angle_increment_rad));
            self.tick_of(readings.flatten().next())
        });
        let ticks: Vec<u16> = ticks.collect();
        Self::from_ticks(lidar.clone(), ticks).unwrap_or_else(|_| self.clone())
    }

    fn turned(&self, start_from_end: &Pose2, order: SweepOrder) -> Vec<Turned> {
        let lidar = self.lidar();
        let twist = start_from_end.log();
        let beams = self.beam_count();
        let lidar_from_base = lidar.mount.inverse();
        let turned = (0..beams).map(|beam| {
            let before = match order {
                SweepOrder::FirstBeamFirst => beam,
                SweepOrder::LastBeamFirst => beams - 1 - beam,
            };
            let share = before as f64 / (beams - 1) as f64;
            let start_from_base = Pose2::exp(&(share * twist));
            let start_from_lidar = lidar_from_base
                .compose(&start_from_base)
                .compose(&lidar.mount);
            let stated_rad = lidar.beam_angle_rad(beam);
            let reading = self.reading(beam);
            let (seen_rad, reading) = match reading {
                Reading::Range(range_m) => {
                    let (sin, cos) = stated_rad.sin_cos();
                    let end = nalgebra::Vector2::new(range_m * cos, range_m * sin);
                    let end = start_from_lidar.transform(&end);
                    (direction_rad(&end), Reading::Range(end.norm()))
                }
                nothing => (stated_rad + start_from_lidar.theta, nothing),
            };
            Turned {
                // On the turn that the beam was stated on.
                direction_rad: stated_rad + wrap_angle(seen_rad - stated_rad),
                reading,
            }
        });
        turned.collect()
    }

    fn tick_of(&self, reading: Option<Reading>) -> u16 {
        let longest = f64::from(INVALID_TICK - 1);
        match reading {
            Some(Reading::Range(range_m)) if range_m < self.lidar().range_max_m => {
                (range_m / self.tick_m()).round().clamp(1.0, longest) as u16
            }
            Some(Reading::Range(_) | Reading::NoReturn) => NO_RETURN_TICK,
            Some(Reading::Invalid) | None => INVALID_TICK,
        }
    }
}

/// The reading in a direction: interpolated between two beams on one surface, else that of the nearer beam.
/// `None` beyond the first and the last.
fn reading_at(turned: &[Turned], direction_rad: f64, increment_rad: f64) -> Option<Reading> {
    let next = turned.partition_point(|beam| beam.direction_rad < direction_rad);
    let after = turned.get(next);
    let before = next.checked_sub(1).map(|k| &turned[k]);
    let is_near =
        |beam: &&Turned| (beam.direction_rad - direction_rad).abs() <= 0.5 * increment_rad;
    let (Some(before), Some(after)) = (before, after) else {
        return before.or(after).filter(is_near).map(|beam| beam.reading);
    };
    let apart_rad = after.direction_rad - before.direction_rad;
    let share = (direction_rad - before.direction_rad) / apart_rad;
    if let (Reading::Range(from_m), Reading::Range(to_m)) = (before.reading, after.reading)
        && (to_m - from_m).abs() <= (SURFACE_SHARE * from_m.min(to_m)).max(SURFACE_M)
    {
        return Some(Reading::Range(from_m + share * (to_m - from_m)));
    }
    Some(if share < 0.5 {
        before.reading
    } else {
        after.reading
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::Lidar;
    use super::SweepOrder::{FirstBeamFirst, LastBeamFirst};
    use super::*;
    use crate::observation::testing::World;

    fn room() -> World {
        World::default()
            .with_rectangle([-4.0, -3.0], [5.0, 3.5])
            .with_rectangle([1.5, 0.5], [2.3, 1.4])
            .with_rectangle([-2.5, -1.8], [-1.9, -0.6])
    }

    fn lidar(field_rad: f64, beams: usize) -> Arc<Lidar> {
        let mount = Pose2::new(0.25, -0.1, 0.4);
        let lidar = crate::observation::testing::lidar(field_rad, beams, 20.0, 0.01);
        Arc::new(Lidar { mount, ..lidar })
    }

    /// The counter-clockwise sweep of a base that moves by `start_from_end` meanwhile.
    fn swept(lidar: &Arc<Lidar>, beams: usize, start_from_end: &Pose2) -> LaserScan {
        swept_in(FirstBeamFirst, lidar, beams, start_from_end)
    }

    fn swept_in(
        order: SweepOrder,
        lidar: &Arc<Lidar>,
        beams: usize,
        start_from_end: &Pose2,
    ) -> LaserScan {
        let twist = start_from_end.log();
        let ranges = (0..beams).map(|beam| {
            let along = beam as f64 / (beams - 1) as f64;
            let share = match order {
                FirstBeamFirst => along,
                LastBeamFirst => 1.0 - along,
            };
            let eye = Pose2::exp(&(share * twist)).compose(&lidar.mount);
            room().range_m(&eye.translation(), eye.theta + lidar.beam_angle_rad(beam))
        });
        LaserScan::new(lidar.clone(), ranges.collect::<Vec<_>>()).unwrap()
    }

    fn errors_m(seen: &LaserScan, truth: &LaserScan) -> Vec<f64> {
        let pairs = seen.ranges_m().zip(truth.ranges_m());
        let mut errors: Vec<f64> = pairs.filter_map(|(a, b)| Some((a? - b?).abs())).collect();
        errors.sort_by(f64::total_cmp);
        errors
    }

    #[test]
    fn a_sweep_of_a_moving_base_is_what_it_would_have_seen_standing() {
        for (field_rad, beams) in [(TAU, 720), (4.5, 541), (3.1, 361)] {
            let lidar = lidar(field_rad, beams);
            let standing = swept(&lidar, beams, &Pose2::IDENTITY);
            for motion in [
                Pose2::new(0.16, 0.0, 0.0),
                Pose2::new(0.1, 0.02, 0.1),
                Pose2::new(0.0, 0.0, -0.12),
            ] {
                // All round and clockwise, two beams at an edge of a pillar change places: such a sweep
                // is left alone.
                let orders = [FirstBeamFirst, LastBeamFirst];
                let orders = &orders[..if field_rad == TAU { 1 } else { 2 }];
                for &order in orders {
                    let raw = swept_in(order, &lidar, beams, &motion);
                    let mended = raw.undistorted(&motion, order);
                    let (before, after) = (errors_m(&raw, &standing), errors_m(&mended, &standing));
                    // Edges apart, which a beam may pass on either side.
                    let worst = |errors: &[f64]| errors[errors.len() * 95 / 100];
                    assert!(worst(&after) < 0.012, "{motion:?}: {}", worst(&after));
                    assert!(worst(&before) > 5.0 * worst(&after), "{motion:?}");
                    assert!(after.len() * 100 > beams * 93, "{} of {beams}", after.len());
                }
            }
        }
    }

    #[test]
    fn what_no_beam_looked_at_says_nothing() {
        let lidar = lidar(3.1, 361);
        let motion = Pose2::new(0.0, 0.0, -0.2);
        let mended = swept(&lidar, 361, &motion).undistorted(&motion, FirstBeamFirst);
        // The last beams looked 0.2 rad less far to the left.
        let unseen = (0..361).filter(|beam| mended.reading(*beam) == Reading::Invalid);
        let unseen: Vec<usize> = unseen.collect();
        assert!((20..=26).contains(&unseen.len()), "{}", unseen.len());
        assert_eq!(unseen.last(), Some(&360));
    }

    #[test]
    fn who_stands_or_spins_is_left_alone() {
        let lidar = lidar(TAU, 360);
        let scan = swept(&lidar, 360, &Pose2::IDENTITY);
        assert_eq!(
            scan.undistorted(&Pose2::new(5e-4, 0.0, 1e-4), FirstBeamFirst),
            scan
        );
        // Turning against the sweep faster than it goes on.
        assert_eq!(
            scan.undistorted(&Pose2::new(0.0, 0.0, -3.1), FirstBeamFirst)
                .beam_count(),
            360
        );
        let none = LaserScan::new(lidar, vec![None; 360]).unwrap();
        assert_eq!(
            none.undistorted(&Pose2::new(0.1, 0.0, 0.1), FirstBeamFirst)
                .return_count(),
            0
        );
    }
}
