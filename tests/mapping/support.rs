//! Simulated drives with the truth beside them.

use std::collections::BTreeMap;
use std::sync::Arc;

use mapshift::geometry::{Pose2, Vector2};
use mapshift::graph::EdgeKind;
use mapshift::ids::{StampNs, TripId};
use mapshift::mapping::{Closure, Drive, DriveScan, Extension, InitialPose, RouteMap, Weighting};
use mapshift::scan::LaserScan;
use mapshift::sim::{OdometryError, Route, Shape, SimLidar, Vehicle, World, drive};

use crate::scans::apart;

/// A workshop of 16 m × 11 m and a way round it.
pub fn workshop() -> (World, Route) {
    let boxes = [
        (8.0, 5.5, 0.0, 3.0, 1.0),
        (4.6, 6.6, 0.5, 1.2, 0.8),
        (12.0, 4.6, 0.0, 0.6, 1.6),
        (1.0, 4.0, 0.0, 0.8, 1.5),
        (14.9, 7.5, 0.2, 0.7, 0.9),
        (6.0, 0.5, 0.0, 1.8, 0.6),
        (10.5, 10.4, 0.0, 1.4, 0.7),
        (2.0, 10.0, 0.8, 0.9, 0.9),
    ];
    let boxes = boxes.map(|(x, y, theta, length_m, width_m)| {
        Shape::rectangle(&Pose2::new(x, y, theta), length_m, width_m)
    });
    let column = Shape::Round {
        centre: Vector2::new(14.8, 1.2),
        radius_m: 0.25,
    };
    let walls = Shape::rectangle(&Pose2::new(8.0, 5.5, 0.0), 16.0, 11.0);
    let world = World::new([walls, column].into_iter().chain(boxes));
    let corners = [(2.8, 2.5), (13.2, 2.5), (13.2, 8.5), (2.8, 8.5)];
    let corners = corners.map(|(x, y)| Vector2::new(x, y));
    (world, Route::new(&corners, 1.2).unwrap())
}

/// A vehicle with a lidar of 360 beams all round, and wheels that err by a hundredth.
pub fn vehicle() -> Vehicle {
    Vehicle {
        lidar: SimLidar::all_round(360, 20.0, 0.01, Pose2::new(0.2, 0.0, 0.0)),
        odometry: OdometryError {
            scale: 0.01,
            yaw_drift_rad_per_m: 5e-4,
            sigma_xy_m: 0.005,
            sigma_theta_rad: 0.003,
        },
        path_noise_m: 0.3,
        scan_spacing_m: 0.25,
        speed_mps: 1.0,
    }
}

/// Another make: it looks ahead over 270° from a turned mount, and its wheels err otherwise.
pub fn other_vehicle() -> Vehicle {
    let mut lidar = SimLidar::all_round(360, 20.0, 0.01, Pose2::new(-0.1, 0.1, 0.5));
    lidar.geometry.angle_min_rad = -135.0_f64.to_radians();
    lidar.geometry.angle_increment_rad = 0.5_f64.to_radians();
    lidar.beams = 541;
    Vehicle {
        lidar,
        odometry: OdometryError {
            scale: -0.008,
            yaw_drift_rad_per_m: -4e-4,
            ..vehicle().odometry
        },
        ..vehicle()
    }
}

/// A drive with the truth beside it.
#[derive(Clone)]
pub struct Trip {
    pub id: TripId,
    pub scans: Vec<DriveScan>,
    /// `map_from_base` of each scan.
    pub truth: Vec<Pose2>,
    /// The lap of each scan.
    pub laps: Vec<usize>,
}

impl Trip {
    /// Laps of a vehicle.
    pub fn record(
        id: &str,
        (world, route): (&World, &Route),
        vehicle: &Vehicle,
        laps: usize,
        seed: u64,
    ) -> Self {
        let recorded = drive(world, route, vehicle, laps, seed);
        let lidar = Arc::new(vehicle.lidar.geometry.clone().validated().unwrap());
        let scan = |k: usize| DriveScan {
            beam_interval_s: 0.0,
            lidar: Default::default(),
            stamp: StampNs((recorded[k].time_s * 1e9) as i64),
            odom_from_base: recorded[k].odom_from_base,
            scan: LaserScan::new(lidar.clone(), recorded[k].ranges_m.clone()).unwrap(),
        };
        Self {
            id: TripId::new(id).unwrap(),
            scans: (0..recorded.len()).map(scan).collect(),
            truth: recorded.iter().map(|s| s.map_from_base).collect(),
            laps: recorded.iter().map(|s| s.lap).collect(),
        }
    }

    /// The scans in a range, as a trip of its own.
    pub fn part(&self, id: &str, range: std::ops::Range<usize>) -> Self {
        Self {
            id: TripId::new(id).unwrap(),
            scans: self.scans[range.clone()].to_vec(),
            truth: self.truth[range.clone()].to_vec(),
            laps: self.laps[range].to_vec(),
        }
    }

    /// Uploads of this many scans; the first one says where the trip starts if `initial_pose` does.
    pub fn batches(&self, size: usize, initial_pose: Option<InitialPose>) -> Vec<Drive> {
        let batch = |(k, scans): (usize, &[DriveScan])| Drive {
            wheels: Default::default(),
            trip: self.id.clone(),
            initial_pose: initial_pose.filter(|_| k == 0),
            scans: scans.to_vec(),
        };
        self.scans.chunks(size).enumerate().map(batch).collect()
    }

    /// Where the trip starts, as someone who knows it well says.
    pub fn start(&self) -> Option<InitialPose> {
        Some(InitialPose {
            pose: self.truth[0],
            sigma_xy_m: 0.01,
            sigma_theta_rad: 0.002,
        })
    }
}

/// Extends a map by all drives, one after the other.
pub fn extend_by(map: &mut RouteMap, drives: &[Drive]) -> Extension {
    let mut all = Extension::default();
    for drive in drives {
        let added = map.extend(drive).unwrap();
        all.nodes.extend(added.nodes);
        all.edges.extend(added.edges);
        all.closures.extend(added.closures);
    }
    all
}

/// A map of trips that know where they start.
pub fn map_of(trips: &[&Trip], batch_scans: usize) -> (RouteMap, Vec<Closure>) {
    let mut map = RouteMap::new(Weighting::Robust);
    let mut closures = Vec::new();
    for trip in trips {
        let added = extend_by(&mut map, &trip.batches(batch_scans, trip.start()));
        closures.extend(added.closures);
    }
    (map, closures)
}

/// The truth for each node of a map, in the order of its nodes.
pub fn truth_of_nodes(map: &RouteMap, trips: &[&Trip]) -> Vec<Pose2> {
    let mut known = BTreeMap::new();
    for trip in trips {
        for (scan, pose) in trip.scans.iter().zip(&trip.truth) {
            known.insert((&trip.id, scan.stamp), *pose);
        }
    }
    let keyframes = map.keyframes().iter();
    keyframes.map(|k| known[&(&k.trip, k.stamp)]).collect()
}

/// How far each node of some trips is from the truth: metres and radians.
pub fn errors(map: &RouteMap, trips: &[&Trip]) -> (Vec<f64>, Vec<f64>) {
    let nodes = map.graph().nodes().iter();
    let truths = truth_of_nodes(map, trips);
    nodes.zip(truths).map(|(n, t)| apart(&t, &n.pose)).unzip()
}

/// How far each closure's measurement is from the truth: metres and radians.
pub fn closure_errors(map: &RouteMap, trips: &[&Trip]) -> (Vec<f64>, Vec<f64>) {
    let graph = map.graph();
    let truths = truth_of_nodes(map, trips);
    let closures = graph.edges().iter().zip(graph.ends());
    let closures = closures.filter(|(edge, _)| edge.kind == EdgeKind::LoopClosure);
    closures
        .map(|(edge, &(from, to))| apart(&truths[from].between(&truths[to]), &edge.measurement))
        .unzip()
}

/// The largest of some values; 0 if there are none.
pub fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

/// Fails unless everything in the map is a number and its parts fit together.
pub fn assert_sound(map: &RouteMap) {
    let graph = map.graph();
    assert_eq!(graph.nodes().len(), map.keyframes().len());
    for (node, keyframe) in graph.nodes().iter().zip(map.keyframes()) {
        assert_eq!(node.id, keyframe.node);
        assert!(node.pose.is_finite(), "{node:?}");
        assert!(keyframe.drift_m.is_finite() && keyframe.drift_m >= 0.0);
        assert!(node.id < map.next_node_id());
    }
    for edge in graph.edges() {
        assert!(edge.measurement.is_finite(), "{edge:?}");
        assert!(edge.information.is_positive_semidefinite(), "{edge:?}");
        assert!(edge.id < map.next_edge_id());
    }
    assert!(graph.cost().is_finite());
}

/// Fails unless two maps are equal to the bit.
pub fn assert_equal(a: &RouteMap, b: &RouteMap) {
    assert_eq!(a.next_node_id(), b.next_node_id());
    assert_eq!(a.next_edge_id(), b.next_edge_id());
    assert_eq!(a.graph().nodes(), b.graph().nodes());
    assert_eq!(a.graph().edges(), b.graph().edges());
    assert_eq!(a.keyframes().len(), b.keyframes().len());
    for (a, b) in a.keyframes().iter().zip(b.keyframes()) {
        let remembered = |k: &mapshift::mapping::Keyframe| {
            let drift = k.drift_m.to_bits();
            (
                k.node,
                k.trip.clone(),
                k.stamp,
                k.odom_from_base,
                k.reference,
                drift,
            )
        };
        assert_eq!(remembered(a), remembered(b));
        assert_eq!(a.scan, b.scan);
        assert_eq!(a.points, b.points);
        assert_eq!(a.intermediate, b.intermediate);
    }
}
