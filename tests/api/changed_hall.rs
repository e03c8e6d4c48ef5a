//! A service with a hall in which a box has appeared.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use mapshift::api::Limits;
use mapshift::change::{
    AlertStatus, ChangeKind, Counterpart, Finding, JudgedPass, JudgedPasses, Tier,
};
use mapshift::geometry::{Information, Pose2, Vector2};
use mapshift::graph::{EdgeKind, EdgeStatus};
use mapshift::ids::{AlertId, BatchId, EdgeId, NodeId, RouteId, StampNs, TripId, VehicleId};
use mapshift::model::{Actor, BatchStatus, Clearance, PassOutcome, PassSide, Stage};
use mapshift::scan::{LaserScan, Lidar, encode_scan};
use mapshift::store::{
    AlertRecord, AlertResidual, Applied, BatchContent, BatchOutcome, ClosureRecord, EdgeRecord,
    GeoAnchor, Handling, HistoryEntry, JobResult, NewBatch, NodeRecord, NodeWithScan, RouteUpdate,
    SYSTEM, Store, StoreOptions,
};
use tempfile::TempDir;

use crate::service::Service;

/// The box that appeared; open.
pub const APPEARED: &str = "019aa000-0000-7000-8000-000000000001";
/// A pillar that was gone for a while; resolved.
pub const DISAPPEARED: &str = "019aa000-0000-7000-8000-000000000002";

const BEAMS: usize = 72;
/// The box: lowest and highest corner, metres.
const BOX: [[f64; 2]; 2] = [[1.5, 0.7], [2.1, 1.3]];
const START_NS: i64 = 1_795_154_400_000_000_000;

/// Starts a service with the route `hall`: three nodes, a closure, two alerts; and the route
/// `yard` without anything, not even a place on the Earth.
pub async fn start() -> Service {
    Service::start_in(directory().await, Limits::default()).await
}

/// What such a service starts from.
pub async fn directory() -> TempDir {
    let directory = TempDir::new().unwrap();
    let data_dir = directory.path().join("data");
    let store = Store::open(StoreOptions { data_dir }).await.unwrap();
    let now = time("2026-11-20T07:00:00Z");
    let (hall, yard) = (RouteId::new("hall").unwrap(), RouteId::new("yard").unwrap());
    let anchored = RouteUpdate {
        geo_anchor: Some(GeoAnchor {
            latitude: 47.5,
            longitude: 19.0,
            heading: 90.0,
        }),
        ..RouteUpdate::default()
    };
    let by = &Actor::System;
    store.put_route(&hall, anchored, by, now).await.unwrap();
    let nothing = RouteUpdate::default();
    store.put_route(&yard, nothing, by, now).await.unwrap();
    store.journal_batch(batch(&hall, now)).await.unwrap();
    let lease = Duration::from_secs(60);
    let job = store.claim_job(now, lease).await.unwrap().unwrap();
    let result = JobResult {
        job_id: job.job_id,
        generation: job.generation,
        base_revision: store.route(&hall).await.unwrap().unwrap().revision,
        outcomes: vec![merged()],
        nodes: (1..=3).map(node).collect(),
        intermediate: Vec::new(),
        edges: vec![
            edge(1, 1, 2, EdgeKind::Odometry),
            edge(2, 2, 3, EdgeKind::Odometry),
            edge(3, 1, 3, EdgeKind::LoopClosure),
        ],
        changed_nodes: Vec::new(),
        changed_edges: Vec::new(),
        alerts: vec![appeared(&hall), disappeared(&hall)],
        calibrations: Vec::new(),
        clock_faults: Vec::new(),
        trip_start: None,
        stage: Stage::Mapping,
        input: job.input(),
        processed_at: now,
        route_id: hall,
    };
    let applied = store.apply_result(result).await.unwrap();
    assert_eq!(applied, Applied::Committed);
    store.close().await.unwrap();
    directory
}

fn time(text: &str) -> Timestamp {
    text.parse().unwrap()
}

fn batch_id() -> BatchId {
    BatchId::new("b-0").unwrap()
}

fn batch(route: &RouteId, now: Timestamp) -> NewBatch {
    NewBatch {
        route_id: route.clone(),
        id: batch_id(),
        vehicle_id: VehicleId::new("agv-07").unwrap(),
        trip_id: TripId::new("trip-1").unwrap(),
        content: BatchContent::Scans {
            sequence: 0,
            scans: 3,
        },
        flags: Vec::new(),
        out_of_range: None,
        extensions: None,
        body: crate::body::batch(0, 3).to_string().into_bytes(),
        received_at: now,
    }
}

fn merged() -> BatchOutcome {
    BatchOutcome {
        batch_id: batch_id(),
        status: BatchStatus::Merged,
        reason: None,
        flags: Vec::new(),
        nodes_added: 3,
        loop_closures: 1,
    }
}

fn pose(id: i64) -> Pose2 {
    match id {
        1 => Pose2::new(0.0, 0.0, 0.0),
        2 => Pose2::new(0.5, 0.0, 0.2),
        _ => Pose2::new(0.3, -0.2, FRAC_PI_2),
    }
}

/// Nodes 1 and 2 were there before the box; node 3 sees it.
fn node(id: i64) -> NodeWithScan {
    NodeWithScan {
        node: NodeRecord {
            id: NodeId(id),
            batch_id: batch_id(),
            vehicle_id: VehicleId::new("agv-07").unwrap(),
            trip_id: TripId::new("trip-1").unwrap(),
            stamp: StampNs(START_NS + id * 1_000_000_000),
            pose: pose(id),
            sigma: None,
            odom_from_base: pose(id),
            drift_m: 0.0,
            reference: id < 3,
            active: true,
            subgraph_id: Some(1),
            trip_order: 0,
            client_id: None,
        },
        scan: Some(encode_scan(&look_around(&pose(id), id == 3)).unwrap()),
        lidar: None,
        intermediate: Vec::new(),
    }
}

/// What stands at |x| = 4 or |y| = 3, and the box; one beam has no return.
fn look_around(map_from_base: &Pose2, with_box: bool) -> LaserScan {
    let lidar = Lidar {
        angle_min_rad: -PI,
        angle_increment_rad: TAU / BEAMS as f64,
        range_min_m: 0.05,
        range_max_m: 20.0,
        mount: Pose2::new(0.2, 0.0, 0.0),
        range_sigma_m: 0.01,
        band: None,
    };
    let eye = map_from_base.compose(&lidar.mount);
    let ranges = (0..BEAMS).map(|beam| {
        let (sin, cos) = (eye.theta + lidar.beam_angle_rad(beam)).sin_cos();
        let wall = |p: f64, d: f64, reach: f64| (reach.copysign(d) - p) / d;
        let walls_m = wall(eye.x, cos, 4.0).min(wall(eye.y, sin, 3.0));
        let slab = |k: usize, p: f64, d: f64| {
            let (a, b) = ((BOX[0][k] - p) / d, (BOX[1][k] - p) / d);
            (a.min(b), a.max(b))
        };
        let ((in_x, out_x), (in_y, out_y)) = (slab(0, eye.x, cos), slab(1, eye.y, sin));
        let (enters_m, leaves_m) = (in_x.max(in_y), out_x.min(out_y));
        let struck = with_box && enters_m > 0.0 && enters_m < leaves_m;
        (beam != 5).then_some(if struck { enters_m } else { walls_m })
    });
    LaserScan::new(Arc::new(lidar.clone()), ranges.collect::<Vec<_>>()).unwrap()
}

fn edge(id: i64, from: i64, to: i64, kind: EdgeKind) -> EdgeRecord {
    let measurement = pose(from).between(&pose(to));
    let information = Information::from_sigmas(0.01, 0.005);
    EdgeRecord {
        id: EdgeId(id),
        from: NodeId(from),
        to: NodeId(to),
        kind,
        status: EdgeStatus::Active,
        batch_id: batch_id(),
        measurement,
        information,
        residual: 0.25,
        subgraph_id: Some(1),
        delta_f: (kind == EdgeKind::LoopClosure).then_some(0.75),
        closure: (kind == EdgeKind::LoopClosure).then_some(ClosureRecord {
            all_points_measurement: measurement,
            all_points_information: information,
            overlap: 0.9,
            inlier_share: 0.95,
            rmse_m: 0.012,
            all_points_residual: 1.5,
        }),
    }
}

fn rectangle([low, high]: [[f64; 2]; 2]) -> Vec<Vector2<f64>> {
    [low, [high[0], low[1]], high, [low[0], high[1]]]
        .map(Vector2::from)
        .to_vec()
}

fn appeared(route: &RouteId) -> AlertRecord {
    let raised_at = time("2026-11-20T06:00:09Z");
    AlertRecord {
        id: APPEARED.parse::<AlertId>().unwrap(),
        route_id: route.clone(),
        revision: 1,
        decision_revision: 1,
        decision_region: rectangle(BOX),
        status: AlertStatus::Open,
        evidence: Finding {
            tier: Tier::Confirmed,
            counterpart: None,
            shift: None,
            suspect: None,
            bands: Vec::new(),
            kind: ChangeKind::Appeared,
            location: Vector2::new(1.8, 1.0),
            sigma_m: 0.06,
            region: rectangle(BOX),
            edges: vec![EdgeId(3)],
            nodes: vec![NodeId(1), NodeId(3)],
            trips: vec![TripId::new("trip-1").unwrap()],
            views: 9,
            laps: 2,
            confidence: 0.998,
            since: StampNs(START_NS + 3_000_000_000),
            last_seen: StampNs(START_NS + 3_000_000_000),
            until: None,
        },
        first_seen: StampNs(START_NS + 3_000_000_000),
        vehicles: vec![VehicleId::new("agv-07").unwrap()],
        passes: Some(passes()),
        clearance: Some(Clearance::Near),
        residual: Some(AlertResidual {
            edge_id: EdgeId(3),
            delta_f: 0.75,
            threshold: None,
            ratio: None,
            p_value: 0.5,
            seed_rule: false,
        }),
        map_version: 1,
        related: Vec::new(),
        raised_at,
        updated_at: raised_at,
        history: vec![by_system(AlertStatus::Open, raised_at, None)],
        handling: Handling::default(),
    }
}

/// One before the box and one since; a third one could not see its place.
fn passes() -> JudgedPasses {
    let pass = |node, side, outcome| JudgedPass {
        trip: TripId::new("trip-1").unwrap(),
        vehicle: VehicleId::new("agv-07").unwrap(),
        begins: StampNs(START_NS + node * 1_000_000_000),
        ends: StampNs(START_NS + node * 1_000_000_000),
        side,
        outcome,
        node: NodeId(node),
    };
    let passes = vec![
        pass(1, PassSide::Before, PassOutcome::OldState),
        pass(2, PassSide::Before, PassOutcome::CouldNotSee),
        pass(3, PassSide::Since, PassOutcome::NewState),
    ];
    JudgedPasses::of(ChangeKind::Appeared, passes)
}

/// Told by nodes alone, without a closure.
fn disappeared(route: &RouteId) -> AlertRecord {
    let raised_at = time("2026-11-20T06:00:10Z");
    let resolved_at = time("2026-11-20T06:30:00Z");
    let first = appeared(route);
    AlertRecord {
        id: DISAPPEARED.parse().unwrap(),
        status: AlertStatus::Resolved,
        evidence: Finding {
            tier: Tier::Tentative,
            counterpart: Some(Counterpart {
                kind: ChangeKind::Appeared,
                region: rectangle(BOX),
            }),
            kind: ChangeKind::Disappeared,
            location: Vector2::new(-2.0, 1.0),
            region: rectangle([[-2.2, 0.8], [-1.8, 1.2]]),
            edges: Vec::new(),
            nodes: vec![NodeId(2), NodeId(3)],
            confidence: 0.91,
            until: Some(StampNs(START_NS + 3_600_000_000_000)),
            ..first.evidence.clone()
        },
        // As alerts are that were raised before passes were kept.
        passes: None,
        clearance: None,
        residual: None,
        raised_at,
        updated_at: resolved_at,
        history: vec![
            by_system(AlertStatus::Open, raised_at, None),
            by_system(AlertStatus::Resolved, resolved_at, Some("no longer seen")),
        ],
        ..first
    }
}

fn by_system(status: AlertStatus, at: Timestamp, note: Option<&str>) -> HistoryEntry {
    HistoryEntry {
        status,
        at,
        by: SYSTEM.to_owned(),
        note: note.map(ToOwned::to_owned),
        reason: None,
    }
}
