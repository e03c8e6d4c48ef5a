//! Whether a vehicle that does not say where it starts is found in a large map, and what that costs.
//!
//! `cargo run --release --example localising -- FIRST_SEED SEEDS` maps office floors of 10,000 m²
//! and 100,000 m² with odometry that does not err, then starts vehicles with poor odometry at places
//! evenly spread along the corridor, and prints how many are placed rightly, placed wrongly and
//! refused after 10, 20 and 40 m, with the seconds that it takes on one core.

use std::f64::consts::PI;
use std::io::Write;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use mapshift::geometry::Pose2;
use mapshift::graph::Edge;
use mapshift::ids::{EdgeId, NodeId, StampNs, TripId};
use mapshift::mapping::{Drive, DriveScan, InitialPose, Keyframe, RouteMap, Weighting};
use mapshift::scan::{LaserScan, Lidar};
use mapshift::sim::{FloorPlan, OdometryError, Rooms, SimLidar, SimScan, Vehicle};

const CORRIDOR_M: f64 = 2.4;
const AREAS_M2: [f64; 2] = [1e4, 1e5];
const WAYS_M: [f64; 3] = [10.0, 20.0, 40.0];
/// Vehicles that start on each floor.
const STARTS: usize = 20;
const SCAN_SPACING_M: f64 = 0.5;
const BATCH_SCANS: usize = 60;
/// Raw odometry: 2 % too long, 5 cm and 1° after a metre.
const POOR: OdometryError = OdometryError {
    scale: 0.02,
    yaw_drift_rad_per_m: 0.0,
    sigma_xy_m: 0.05,
    sigma_theta_rad: PI / 180.0,
};
const PERFECT: OdometryError = OdometryError {
    scale: 0.0,
    yaw_drift_rad_per_m: 0.0,
    sigma_xy_m: 0.0,
    sigma_theta_rad: 0.0,
};
/// A vehicle is placed rightly if it is no farther off than this beside the mapped scan next to it,
/// metres and radians.
const RIGHT_M: f64 = 0.3;
const RIGHT_RAD: f64 = 0.05;

/// What came of the vehicles of one row.
#[derive(Default)]
struct Row {
    right: usize,
    wrong_m: Vec<f64>,
    refused: usize,
    seconds: Vec<f64>,
}

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1).map(|a| a.parse::<u64>());
    let mut number = || {
        arguments
            .next()
            .context("usage: localising FIRST_SEED SEEDS")
    };
    let (first_seed, seeds) = (number()??, number()??);
    let mut console = std::io::stdout();
    for area_m2 in AREAS_M2 {
        let mut rows = WAYS_M.map(|_| Row::default());
        for seed in first_seed..first_seed + seeds {
            measure(area_m2, seed, &mut rows)?;
        }
        for (way_m, row) in WAYS_M.iter().zip(&mut rows) {
            row.seconds.sort_by(f64::total_cmp);
            let at = |share: f64| row.seconds[(share * (row.seconds.len() - 1) as f64) as usize];
            writeln!(
                console,
                "{area_m2} m², after {way_m} m: {} right, {} wrong, by {:.1?} m, {} refused; {:.2} s \
                 (median), {:.2} s (most)",
                row.right,
                row.wrong_m.len(),
                row.wrong_m,
                row.refused,
                at(0.5),
                at(1.0),
            )?;
        }
    }
    Ok(())
}

/// A floor whose outer walls enclose so much, square metres.
fn floor_of(area_m2: f64) -> FloorPlan {
    let mut way_m = 50.0;
    loop {
        let plan = FloorPlan::round(way_m, CORRIDOR_M);
        if plan.length_m * plan.width_m >= area_m2 {
            return plan;
        }
        way_m += 1.0;
    }
}

fn measure(area_m2: f64, seed: u64, rows: &mut [Row; 3]) -> anyhow::Result<()> {
    let scene = Rooms::of_plan(&floor_of(area_m2), seed)?.scene;
    let vehicle = |odometry| Vehicle {
        lidar: SimLidar::sector(PI, 181, 30.0, 0.01, Pose2::new(0.2, 0.0, 0.0)),
        odometry,
        path_noise_m: 0.2,
        scan_spacing_m: SCAN_SPACING_M,
        speed_mps: 0.8,
    };
    let (mapping, lost) = (vehicle(PERFECT), vehicle(POOR));
    let lidar = Arc::new(mapping.lidar.geometry.clone().validated()?);
    let first = scene.drive(&mapping, 0..1, seed);
    let saved = map_of(&first, &lidar)?;
    let second = scene.drive(&lost, 1..2, seed);
    for start in 0..STARTS {
        let from = start * second.len() / STARTS;
        for (way_m, row) in WAYS_M.iter().zip(&mut *rows) {
            let count = (way_m / SCAN_SPACING_M) as usize;
            let seen: Vec<SimScan> = second
                .iter()
                .cycle()
                .skip(from)
                .take(count)
                .cloned()
                .collect();
            if seen.windows(2).any(|two| two[1].time_s < two[0].time_s) {
                // It would jump from the end of the lap to its start.
                continue;
            }
            let mut map = saved.restored()?;
            let drive = Drive {
                wheels: Default::default(),
                trip: TripId::new("lost")?,
                initial_pose: None,
                scans: scans_of(&seen, &lidar)?,
            };
            let began = Instant::now();
            let placed = map.extend(&drive).is_ok();
            row.seconds.push(began.elapsed().as_secs_f64());
            match placed.then(|| off(&map, &first, &seen)).flatten() {
                Some([off_m, off_rad]) if off_m <= RIGHT_M && off_rad <= RIGHT_RAD => {
                    row.right += 1;
                }
                Some([off_m, _]) => row.wrong_m.push(off_m),
                None => row.refused += 1,
            }
        }
    }
    Ok(())
}

/// A map to begin again with.
struct Saved {
    nodes: Vec<(Pose2, Keyframe)>,
    edges: Vec<Edge>,
    next: (NodeId, EdgeId),
}

impl Saved {
    fn restored(&self) -> anyhow::Result<RouteMap> {
        let (nodes, edges) = (self.nodes.iter().cloned(), self.edges.iter().cloned());
        Ok(RouteMap::restore(
            Weighting::Robust,
            nodes,
            edges,
            self.next.0,
            self.next.1,
        )?)
    }
}

fn map_of(scans: &[SimScan], lidar: &Arc<Lidar>) -> anyhow::Result<Saved> {
    let mut map = RouteMap::new(Weighting::Robust);
    for batch in scans.chunks(BATCH_SCANS) {
        let start = batch.first().filter(|_| map.keyframes().is_empty());
        let drive = Drive {
            wheels: Default::default(),
            trip: TripId::new("first")?,
            initial_pose: start.map(|scan| InitialPose {
                pose: scan.map_from_base,
                sigma_xy_m: 0.01,
                sigma_theta_rad: 0.002,
            }),
            scans: scans_of(batch, lidar)?,
        };
        map.extend(&drive)?;
    }
    let poses = map.graph().nodes().iter().map(|node| node.pose);
    Ok(Saved {
        nodes: poses.zip(map.keyframes().iter().cloned()).collect(),
        edges: map.graph().edges().to_vec(),
        next: (map.next_node_id(), map.next_edge_id()),
    })
}

fn scans_of(scans: &[SimScan], lidar: &Arc<Lidar>) -> anyhow::Result<Vec<DriveScan>> {
    let scans = scans.iter().map(|scan| {
        Ok(DriveScan {
            beam_interval_s: 0.0,
            lidar: Default::default(),
            stamp: stamp(scan),
            odom_from_base: scan.odom_from_base,
            scan: LaserScan::new(lidar.clone(), scan.ranges_m.iter().copied())?,
        })
    });
    scans.collect()
}

fn stamp(scan: &SimScan) -> StampNs {
    StampNs((1e9 * scan.time_s) as i64)
}

/// How far the drive's newest keyframe is off beside the mapped one next to it, metres and radians.
fn off(map: &RouteMap, mapped: &[SimScan], seen: &[SimScan]) -> Option<[f64; 2]> {
    let lost = TripId::new("lost").ok();
    let placed = || map.keyframes().iter().zip(map.graph().nodes());
    let truth = |keyframe: &Keyframe, scans: &[SimScan]| {
        let scan = scans.iter().find(|scan| stamp(scan) == keyframe.stamp)?;
        Some(scan.map_from_base)
    };
    let mut own = placed().filter(|(keyframe, _)| Some(&keyframe.trip) == lost.as_ref());
    let own = own.next_back();
    let (own_truth, own_pose) = own.and_then(|(k, node)| Some((truth(k, seen)?, node.pose)))?;
    let others = placed().filter(|(keyframe, _)| Some(&keyframe.trip) != lost.as_ref());
    let others = others.filter_map(|(k, node)| Some((truth(k, mapped)?, node.pose)));
    let apart_m = |pose: &Pose2| (pose.translation() - own_truth.translation()).norm();
    let nearest = others.min_by(|(a, _), (b, _)| apart_m(a).total_cmp(&apart_m(b)));
    let (there, pose) = nearest?;
    let off = there.between(&own_truth).between(&pose.between(&own_pose));
    Some([off.translation().norm(), off.theta.abs()])
}
