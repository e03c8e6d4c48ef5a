use std::sync::Arc;

use proptest::prelude::*;

use super::super::drive::LidarOfVehicle;
use super::super::route_map::Weighting;
use super::*;
use crate::geometry::Pose2;
use crate::ids::TripId;
use crate::observation::testing::all_round;
use crate::scan::LaserScan;

/// A scan of the lidar at a place, so many milliseconds after the first.
fn scan(place: usize, ms: i64) -> DriveScan {
    let names = ["front", "rear", "left"];
    DriveScan {
        beam_interval_s: 0.0,
        lidar: LidarOfVehicle {
            name: Some(LidarId::new(names[place]).unwrap()),
            place,
        },
        stamp: StampNs(1_000_000 * ms),
        odom_from_base: Pose2::IDENTITY,
        scan: LaserScan::new(Arc::new(all_round(4)), [Some(1.0); 4]).unwrap(),
    }
}

fn drive(scans: &[(usize, i64)]) -> Drive {
    Drive {
        wheels: Default::default(),
        trip: TripId::new("t").unwrap(),
        initial_pose: None,
        scans: scans.iter().map(|(place, ms)| scan(*place, *ms)).collect(),
    }
}

fn ms(scan: &DriveScan) -> Taken {
    (scan.lidar.place, scan.stamp.0 / 1_000_000)
}

/// A scan's lidar, and when it was taken, milliseconds.
type Taken = (usize, i64);

/// Each moment as its own scan and those that lend it their points.
fn walked(drive: &Drive) -> Vec<(Taken, Vec<Taken>)> {
    let map = RouteMap::new(Weighting::Robust);
    let moments = map.moments(drive).into_iter();
    let walked = moments.map(|moment| match moment {
        Moment::Primary { scan, lent } => (ms(scan), lent.into_iter().map(ms).collect()),
        Moment::Companion(scan) => (ms(scan), vec![]),
    });
    walked.collect()
}

#[test]
fn a_companions_nearest_scan_lends_and_the_others_stand_alone() {
    let drive = drive(&[
        (1, 0),
        (0, 300),
        (1, 310),
        (2, 320),
        (1, 390),
        (0, 400),
        (1, 450),
        (0, 500),
        (1, 601),
    ]);
    let expected = [
        // What was seen before the first primary scan follows it.
        ((0, 300), vec![(1, 310), (2, 320)]),
        ((1, 0), vec![]),
        // Half-way between two it is the earlier one's: but there a nearer one lends.
        ((0, 400), vec![(1, 390)]),
        ((1, 450), vec![]),
        ((0, 500), vec![]),
        // A tenth of a second is near enough, more is not.
        ((1, 601), vec![]),
    ];
    assert_eq!(walked(&drive), expected);
}

#[test]
fn the_first_lidar_with_scans_is_the_primary_one() {
    let moments = walked(&drive(&[(2, 0), (1, 5), (2, 100), (1, 105)]));
    assert_eq!(
        moments,
        [((1, 5), vec![(2, 0)]), ((1, 105), vec![(2, 100)])]
    );
}

#[test]
fn nothing_is_lent_across_a_jump_of_the_odometry() {
    let mut drive = drive(&[(0, 0), (1, 20), (0, 100), (1, 120)]);
    for scan in &mut drive.scans[3..] {
        scan.odom_from_base = Pose2::new(5.0, 0.0, 0.0);
    }
    let expected = [
        ((0, 0), vec![(1, 20)]),
        ((0, 100), vec![]),
        ((1, 120), vec![]),
    ];
    assert_eq!(walked(&drive), expected);
}

#[test]
fn scans_without_a_name_are_all_primary() {
    let mut drive = drive(&[(0, 0), (0, 50), (0, 100)]);
    for scan in &mut drive.scans {
        scan.lidar = LidarOfVehicle::default();
    }
    let moments = walked(&drive);
    assert!(moments.iter().all(|(_, lent)| lent.is_empty()));
    assert_eq!(moments.len(), 3);
}

proptest! {
    /// Compared with every pair of a primary scan and a companion's.
    #[test]
    fn every_scan_has_one_part(steps in proptest::collection::vec((0usize..3, 0i64..160), 1..40)) {
        let mut now = [0; 3];
        let mut latest = 0;
        let scans: Vec<(usize, i64)> = steps.into_iter().map(|(place, step)| {
            latest = (latest + step).max(now[place] + 1);
            now[place] = latest;
            (place, latest)
        }).collect();
        let moments = walked(&drive(&scans));
        let mut seen: Vec<_> = moments.iter().flat_map(|(own, lent)| {
            std::iter::once(*own).chain(lent.iter().copied())
        }).collect();
        seen.sort_unstable();
        let mut all = scans.clone();
        all.sort_unstable();
        prop_assert_eq!(seen, all);
        let first = scans.iter().map(|(place, _)| *place).min().unwrap();
        let primaries = || scans.iter().filter(|(place, _)| *place == first);
        for (own, lent) in &moments {
            prop_assert!(lent.is_empty() || own.0 == first);
            for lender in lent {
                let apart = (lender.1 - own.1).abs();
                prop_assert!(apart <= 100);
                prop_assert!(primaries().all(|other| (lender.1 - other.1).abs() >= apart));
                let of_lidar = lent.iter().filter(|other| other.0 == lender.0);
                prop_assert_eq!(of_lidar.count(), 1);
            }
        }
    }
}
