use std::f64::consts::TAU;
use std::sync::Arc;

use super::*;
use crate::geometry::Pose2;
use crate::ids::AlertId;
use crate::scan::{LaserScan, Lidar};

const WALL_M: f64 = 6.0;

/// A scan in the middle of a round room with some discs in it.
fn scan(eye: &Vector2<f64>, discs: &[(Vector2<f64>, f64)]) -> LaserScan {
    let lidar = Lidar {
        angle_min_rad: 0.0,
        angle_increment_rad: TAU / 720.0,
        range_min_m: 0.05,
        range_max_m: 20.0,
        mount: Pose2::IDENTITY,
        range_sigma_m: 0.01,
    };
    let lidar = Arc::new(lidar.validated().unwrap());
    let range_m = |beam: usize| {
        let (sin, cos) = lidar.beam_angle_rad(beam).sin_cos();
        let direction = Vector2::new(cos, sin);
        let to = |centre: &Vector2<f64>, radius_m: f64, sign: f64| {
            let along = (centre - eye).dot(&direction);
            let across = (centre - eye).perp(&direction);
            let half = (radius_m * radius_m - across * across).sqrt();
            Some(along + sign * half).filter(|range_m| *range_m > 0.0)
        };
        let wall = to(&Vector2::zeros(), WALL_M, 1.0);
        let near = discs
            .iter()
            .filter_map(|(centre, radius_m)| to(centre, *radius_m, -1.0));
        near.chain(wall).min_by(f64::total_cmp)
    };
    LaserScan::new(lidar.clone(), (0..720).map(range_m)).unwrap()
}

/// Laps of ten scans on a small circle: what stands in each lap.
struct Laps {
    scans: Vec<(usize, usize, Pose2, LaserScan)>,
    trips: Vec<TripId>,
}

impl Laps {
    fn new(laps: &[&[(Vector2<f64>, f64)]]) -> Self {
        let mut scans = Vec::new();
        for (lap, discs) in laps.iter().enumerate() {
            for k in 0..10 {
                let (sin, cos) = (TAU * k as f64 / 10.0).sin_cos();
                let eye = Vector2::new(cos, sin);
                scans.push((lap, k, Pose2::new(cos, sin, 0.0), scan(&eye, discs)));
            }
        }
        let trips = (0..laps.len()).map(|lap| TripId::new(format!("lap-{lap}")).unwrap());
        Self {
            scans,
            trips: trips.collect(),
        }
    }

    fn findings(
        &self,
        suspicions: &[Suspicion],
        accepted: &[AcceptedChange],
        watched: &[Vec<Vector2<f64>>],
    ) -> Vec<Finding> {
        let looks = self.scans.iter().map(|(lap, k, pose, scan)| {
            let number = (10 * lap + k) as i64;
            Look::new(NodeId(number), (*lap, *k), StampNs(number), pose, scan)
        });
        detect(&Evidence {
            looks: &looks.collect::<Vec<_>>(),
            trips: &self.trips,
            suspicions,
            accepted,
            watched,
        })
    }
}

fn suspicions(spots: &[Vector2<f64>], fresh: bool) -> Vec<Suspicion> {
    let points = spots.iter().flat_map(|spot| {
        (0..6).map(move |k| Suspicion {
            edge: EdgeId(k),
            node: NodeId(20 + k),
            spot: spot + Vector2::new(0.01 * k as f64, 0.0),
            taken: (StampNs(0), StampNs(i64::MAX)),
            fresh,
        })
    });
    points.collect()
}

fn post() -> (Vector2<f64>, f64) {
    (Vector2::new(2.95, 0.55), 0.2)
}

#[test]
fn what_came_is_found_where_it_stands() {
    let laps = Laps::new(&[&[], &[], &[post()], &[post()]]);
    let spots = [Vector2::new(2.9, 0.5)];
    let findings = laps.findings(&suspicions(&spots, true), &[], &[]);
    assert_eq!(findings.len(), 1, "{findings:?}");
    let finding = &findings[0];
    assert_eq!(finding.kind, ChangeKind::Appeared);
    assert!(
        (finding.location - spots[0]).norm() < 0.1,
        "{}",
        finding.location
    );
    assert_eq!((finding.since, finding.until), (StampNs(20), None));
    let names: Vec<_> = finding.trips.iter().map(TripId::as_str).collect();
    assert_eq!(names, ["lap-2", "lap-3"]);
    assert!(finding.edges.is_sorted() && finding.nodes.is_sorted());
    assert_eq!(finding.edges.len(), 6);
}

#[test]
fn what_went_is_found_where_it_stood() {
    let laps = Laps::new(&[&[post()], &[post()], &[], &[]]);
    let findings = laps.findings(&suspicions(&[Vector2::new(2.9, 0.5)], true), &[], &[]);
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert_eq!(findings[0].kind, ChangeKind::Disappeared);
}

#[test]
fn a_suspicion_alone_decides_nothing() {
    let laps = Laps::new(&[&[], &[], &[], &[]]);
    let empty = suspicions(&[Vector2::new(2.9, 0.5)], true);
    assert_eq!(laps.findings(&empty, &[], &[]), []);
    let laps = Laps::new(&[&[post()], &[post()], &[post()], &[post()]]);
    assert_eq!(laps.findings(&empty, &[], &[]), []);
}

#[test]
fn spots_are_decided_anew_when_suspected_or_watched() {
    let laps = Laps::new(&[&[], &[], &[post()], &[post()]]);
    let old = suspicions(&[Vector2::new(2.9, 0.5)], false);
    assert_eq!(laps.findings(&old, &[], &[]), []);
    let region = region_round(&[Vector2::new(2.9, 0.5)], 0.3);
    assert_eq!(laps.findings(&old, &[], &[region]).len(), 1);
}

#[test]
fn what_was_accepted_is_not_found_again_but_its_going_is() {
    let region = region_round(&[Vector2::new(2.9, 0.5)], 0.3);
    let accepted = [AcceptedChange {
        alert_id: AlertId(uuid::Uuid::nil()),
        region,
        since: StampNs(20),
        map_version: 2,
        nodes: Vec::new(),
        first_edge_id: EdgeId(9),
    }];
    let suspected = suspicions(&[Vector2::new(2.9, 0.5)], true);
    let laps = Laps::new(&[&[], &[], &[post()], &[post()]]);
    assert_eq!(laps.findings(&suspected, &accepted, &[]), []);
    let laps = Laps::new(&[&[], &[], &[post()], &[post()], &[], &[]]);
    let findings = laps.findings(&suspected, &accepted, &[]);
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert_eq!(findings[0].kind, ChangeKind::Disappeared);
    assert_eq!(findings[0].since, StampNs(40));
}

#[test]
fn places_apart_are_findings_apart() {
    let posts = [post(), (Vector2::new(-2.6, -1.3), 0.25)];
    let laps = Laps::new(&[&[], &[], &posts, &posts]);
    let spots = [Vector2::new(2.8, 0.5), Vector2::new(-2.5, -1.2)];
    let findings = laps.findings(&suspicions(&spots, true), &[], &[]);
    assert_eq!(findings.len(), 2, "{findings:?}");
}
