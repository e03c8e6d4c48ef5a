//! Scores of cases made by hand.

use std::sync::Arc;

use super::super::laps::RecordedScan;
use super::super::mapped::{MadeClosure, MapError};
use super::*;
use crate::change::paper::ClosurePlace;
use crate::geometry::{Information, Pose2, Vector2};
use crate::ids::{EdgeId, StampNs};
use crate::mapping::{Closure, DriveScan, RouteMap, Weighting};
use crate::matching::{Estimate, Termination};
use crate::scan::{LaserScan, Lidar};
use crate::sim::Shape;

const LAPS: usize = 6;
const BEFORE: usize = 4;
const SCANS_A_LAP: usize = 3;

/// Three scans a lap at x = 0, 10 and 20 m. A box of 1 m appears beside the first, and one
/// disappears beside the second; the third looks at neither.
fn laps() -> Laps {
    let lidar = Arc::new(Lidar {
        angle_min_rad: 0.0,
        angle_increment_rad: 0.1,
        range_min_m: 0.1,
        range_max_m: 10.0,
        mount: Pose2::IDENTITY,
        range_sigma_m: 0.01,
        band: None,
    });
    let scan = |k: usize| {
        let spot = k % SCANS_A_LAP;
        RecordedScan {
            scan: DriveScan {
                beam_interval_s: 0.0,
                lidar: Default::default(),
                stamp: StampNs(k as i64),
                odom_from_base: Pose2::IDENTITY,
                scan: LaserScan::new(lidar.clone(), [Some(1.0)]).unwrap(),
            },
            lap: k / SCANS_A_LAP,
            truth: Pose2::new(10.0 * spot as f64, 0.0, 0.0),
            differing: [0.2, 0.02, 0.0][spot],
            observes: [vec![0], vec![1], vec![]][spot].clone(),
        }
    };
    let change = |kind, x| TrueChange {
        kind,
        shape: Shape::rectangle(&Pose2::new(x, 2.0, 0.0), 1.0, 1.0),
        area_share: 0.02,
        visible: true,
        first_lap: Some(BEFORE),
    };
    Laps {
        scans: (0..LAPS * SCANS_A_LAP).map(scan).collect(),
        changes: vec![
            change(ChangeKind::Appeared, 0.0),
            change(ChangeKind::Disappeared, 10.0),
        ],
        before: BEFORE,
        count: LAPS,
        appeared_area_share: 0.02,
    }
}

/// Every scan from the second lap on is tied to the first lap's scan at its spot.
fn mapped(laps: &Laps) -> Mapped {
    let estimate = Estimate {
        pose: Pose2::IDENTITY,
        information: Information::identity(),
        observable_directions: 3,
        overlap: 1.0,
        inlier_share: 1.0,
        rmse_m: 0.0,
        termination: Termination::Converged,
    };
    let closure = |new: usize| MadeClosure {
        closure: Closure {
            edge: EdgeId(new as i64),
            robust: estimate,
            all_points_measurement: Pose2::IDENTITY,
            all_points_information: Information::identity(),
            delta_f: 0.0,
            all_points_residual: 0.0,
        },
        old: new % SCANS_A_LAP,
        new,
        place: ClosurePlace {
            position: laps.scans[new].truth.translation(),
            lap: laps.scans[new].lap,
        },
    };
    Mapped {
        map: RouteMap::new(Weighting::Robust),
        closures: (SCANS_A_LAP..laps.scans.len()).map(closure).collect(),
        findings: Vec::new(),
        error: MapError::default(),
        exclusion: None,
    }
}

fn region(lap: usize, kind: ChangeKind, x: f64, y: f64) -> Raised {
    let corner = |dx: f64, dy: f64| Vector2::new(x + dx, y + dy);
    Raised {
        lap,
        what: Reported::Region {
            kind,
            location: corner(0.0, 0.0),
            region: vec![
                corner(-0.1, -0.1),
                corner(0.1, -0.1),
                corner(0.1, 0.1),
                corner(-0.1, 0.1),
            ],
        },
    }
}

fn reported_regions(raised: Vec<Raised>) -> Score {
    let laps = laps();
    let mapped = mapped(&laps);
    let judged = Judged {
        raised,
        ..Judged::by_closure(&mapped, None, vec![false; mapped.closures.len()])
    };
    Score::of(&laps, &mapped, &judged)
}

#[test]
fn closures_are_counted_by_what_their_scans_show() {
    let laps = laps();
    let mapped = mapped(&laps);
    // Reported: everything in the laps after the change.
    let reported = mapped.closures.iter().map(|c| c.place.lap >= BEFORE);
    let scores: Vec<f64> = mapped.closures.iter().map(|c| c.place.lap as f64).collect();
    let judged = Judged::by_closure(&mapped, Some(scores), reported.collect());
    let score = Score::of(&laps, &mapped, &judged);
    // Two laps after the change: the first spot shows it, the second too little, the third not.
    assert_eq!(score.closures.found, 2);
    assert_eq!(score.closures_between, 2);
    assert_eq!(score.closures.false_alarms, 2);
    // Two judged laps before it, and one that is not judged.
    assert_eq!(score.closures.left_alone, 6);
    assert_eq!(score.closures_not_judged, 3);
    let (changed, unchanged) = score.roc.unwrap();
    assert_eq!((changed.len(), unchanged.len()), (2, 8));
}

#[test]
fn a_lap_counts_once_and_later_ones_apart() {
    let appeared = |lap| region(lap, ChangeKind::Appeared, 0.0, 2.0);
    let score = reported_regions(vec![appeared(3), appeared(4), appeared(5)]);
    let expected = Counts {
        found: 1,
        missed: 0,
        false_alarms: 1,
        left_alone: 1,
    };
    assert_eq!(score.laps, expected);
    assert_eq!(score.laps_later, Share { hits: 1, of: 1 });
    assert_eq!(score.laps_not_judged, 2);
    let silent = reported_regions(Vec::new());
    assert_eq!((silent.laps.missed, silent.laps.left_alone), (1, 2));
}

#[test]
fn what_nobody_can_see_is_no_changed_lap() {
    let mut laps = laps();
    for change in &mut laps.changes {
        change.visible = false;
    }
    let mapped = mapped(&laps);
    let judged = Judged::by_closure(&mapped, None, vec![false; mapped.closures.len()]);
    let score = Score::of(&laps, &mapped, &judged);
    assert_eq!((score.laps_unseen, score.laps.missed), (2, 0));
    assert!(score.events.is_empty());
}

#[test]
fn regions_tell_changes_of_their_kind_where_they_are() {
    // The box reaches to y = 1.5; the region 0.1 m farther than its middle.
    let near = reported_regions(vec![region(4, ChangeKind::Appeared, 0.0, 1.1)]);
    assert_eq!((near.true_alerts, near.false_alerts), (1, 0));
    let event = near.events[0];
    assert!(event.found && event.laps_until_raised == Some(0));
    assert!((event.location_error_m.unwrap() - 0.9).abs() < 1e-9);
    assert!(!near.events[1].found);

    let wrong_kind = region(4, ChangeKind::Disappeared, 0.0, 2.0);
    let too_far = region(4, ChangeKind::Appeared, 0.0, 0.9);
    let too_early = region(3, ChangeKind::Appeared, 0.0, 2.0);
    let score = reported_regions(vec![wrong_kind, too_far, too_early]);
    assert_eq!((score.true_alerts, score.false_alerts), (0, 3));
    assert_eq!(score.false_alert_places[1], [0.0, 0.9]);
}

#[test]
fn the_first_alert_of_a_change_counts() {
    let late = region(5, ChangeKind::Disappeared, 10.0, 2.0);
    let later = region(5, ChangeKind::Disappeared, 10.3, 2.0);
    let score = reported_regions(vec![late, later]);
    assert_eq!(score.true_alerts, 2);
    assert_eq!(score.events[1].laps_until_raised, Some(1));
}

#[test]
fn closures_report_what_their_scans_observe_if_they_cross_the_change() {
    let closure = |lap: usize, spot: usize| Raised {
        lap,
        what: Reported::Closure {
            old: spot,
            new: lap * SCANS_A_LAP + spot,
            position: Vector2::new(10.0 * spot as f64, 0.0),
        },
    };
    let score = reported_regions(vec![closure(4, 0), closure(3, 1), closure(4, 2)]);
    assert_eq!((score.true_alerts, score.false_alerts), (1, 2));
    assert!(score.events[0].found && !score.events[1].found);
    assert!((score.events[0].location_error_m.unwrap() - 2.0).abs() < 1e-9);
}
