//! A service in a directory of its own, with or without a small map in it.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use mapshift::api::{AccessOptions, Limits, Pace};
use mapshift::app::{self, RunningApp};
use mapshift::config::AppConfig;
use mapshift::geometry::{Information, Pose2, PoseSigma};
use mapshift::graph::{EdgeKind, EdgeStatus};
use mapshift::ids::{BatchId, EdgeId, NodeId, RouteId, StampNs, TripId, VehicleId};
use mapshift::model::{Actor, BatchStatus, Stage};
use mapshift::pipeline::PipelineOptions;
use mapshift::scan::{LaserScan, Lidar, encode_scan};
use mapshift::store::{
    Applied, BatchContent, BatchOutcome, ClosureRecord, EdgeRecord, IntermediateRecord, JobResult,
    NewBatch, NewIntermediate, NodeRecord, NodeWithScan, RouteUpdate, Store, StoreOptions,
};
use mapshift::webhooks::DeliveryOptions;
use tempfile::TempDir;

use crate::client::{Answer, Request};

/// A running service; its directory goes with it.
pub struct Service {
    pub app: RunningApp,
    pub address: SocketAddr,
    directory: TempDir,
}

impl Service {
    pub async fn start() -> Self {
        Self::start_in(TempDir::new().unwrap(), Limits::default()).await
    }

    pub async fn start_with(limits: Limits) -> Self {
        Self::start_in(TempDir::new().unwrap(), limits).await
    }

    /// With the route `hall`: one batch, three nodes, two odometry edges, one loop closure.
    pub async fn start_with_map() -> Self {
        let directory = TempDir::new().unwrap();
        seed(&directory).await;
        Self::start_in(directory, Limits::default()).await
    }

    /// With the route `hall`, whose graph has several megabytes.
    pub async fn start_with_long_route(limits: Limits) -> Self {
        let directory = TempDir::new().unwrap();
        seed_chain(&directory, 5_000).await;
        Self::start_in(directory, limits).await
    }

    pub async fn start_in(directory: TempDir, limits: Limits) -> Self {
        Self::start_delivering(directory, limits, DeliveryOptions::default()).await
    }

    pub async fn start_delivering(
        directory: TempDir,
        limits: Limits,
        delivery: DeliveryOptions,
    ) -> Self {
        Self::start_changed(directory, |config| {
            config.limits = limits;
            config.delivery = delivery;
        })
        .await
    }

    /// With settings that differ from the usual ones.
    pub async fn start_changed(directory: TempDir, change: impl FnOnce(&mut AppConfig)) -> Self {
        let mut config = AppConfig {
            listen: "127.0.0.1:0".parse().unwrap(),
            data_dir: directory.path().join("data"),
            accept_lost_log: false,
            limits: Limits::default(),
            pipeline: PipelineOptions::default(),
            delivery: DeliveryOptions::default(),
            access: AccessOptions::default(),
            insecure_open_to_network: false,
        };
        change(&mut config);
        let app = app::start(config).await.unwrap();
        Self {
            address: app.local_addr(),
            app,
            directory,
        }
    }

    pub async fn send(&self, request: Request) -> Answer {
        request.send(self.address).await
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.send(Request::new("GET", path)).await
    }

    pub async fn put_route(&self, route: &str) {
        let put = Request::new("PUT", format!("/v1/routes/{route}"));
        assert_eq!(self.send(put).await.status, 201);
    }

    pub async fn stop(self) {
        self.stop_keeping().await;
    }

    /// Hands back the directory, for another service to go on in.
    pub async fn stop_keeping(self) -> TempDir {
        self.app.shutdown().await.unwrap();
        self.directory
    }
}

/// Short times, so that slow clients are met in a test.
pub fn short_limits() -> Limits {
    Limits {
        header_timeout: Duration::from_millis(300),
        body_pace: Pace {
            grace: Duration::from_millis(300),
            ..Limits::default().body_pace
        },
        ..Limits::default()
    }
}

async fn seed(directory: &TempDir) {
    let intermediate = vec![intermediate(2, 0), intermediate(2, 1), intermediate(3, 0)];
    let edges = vec![
        edge(1, 1, 2, EdgeKind::Odometry),
        edge(2, 2, 3, EdgeKind::Odometry),
        edge(3, 1, 3, EdgeKind::LoopClosure),
    ];
    store_map(directory, (1..=3).map(node).collect(), intermediate, edges).await;
}

/// So many nodes, each with an edge to the one before it.
async fn seed_chain(directory: &TempDir, count: i64) {
    let nodes = (1..=count).map(node).collect();
    let edges = (1..count).map(|id| edge(id, id, id + 1, EdgeKind::Odometry));
    store_map(directory, nodes, Vec::new(), edges.collect()).await;
}

async fn store_map(
    directory: &TempDir,
    nodes: Vec<NodeWithScan>,
    intermediate: Vec<NewIntermediate>,
    edges: Vec<EdgeRecord>,
) {
    let data_dir = directory.path().join("data");
    let store = Store::open(StoreOptions { data_dir }).await.unwrap();
    let now: Timestamp = "2026-11-20T07:00:00Z".parse().unwrap();
    let route_id = RouteId::new("hall").unwrap();
    store
        .put_route(&route_id, RouteUpdate::default(), &Actor::System, now)
        .await
        .unwrap();
    let body = crate::body::batch(0, 3).to_string().into_bytes();
    let batch = NewBatch {
        route_id: route_id.clone(),
        id: BatchId::new("b-0").unwrap(),
        vehicle_id: VehicleId::new("agv-07").unwrap(),
        trip_id: TripId::new("trip-1").unwrap(),
        content: BatchContent::Scans {
            sequence: 0,
            scans: 3,
        },
        flags: Vec::new(),
        out_of_range: None,
        extensions: None,
        body,
        received_at: now,
    };
    store.journal_batch(batch).await.unwrap();
    let lease = Duration::from_secs(60);
    let job = store.claim_job(now, lease).await.unwrap().unwrap();
    let base_revision = store.route(&route_id).await.unwrap().unwrap().revision;
    let result = JobResult {
        job_id: job.job_id,
        generation: job.generation,
        base_revision,
        outcomes: vec![BatchOutcome {
            batch_id: BatchId::new("b-0").unwrap(),
            status: BatchStatus::Merged,
            reason: None,
            flags: Vec::new(),
            nodes_added: nodes.len() as i64,
            loop_closures: 1,
        }],
        nodes,
        intermediate,
        edges,
        changed_nodes: Vec::new(),
        changed_edges: Vec::new(),
        alerts: Vec::new(),
        calibrations: Vec::new(),
        clock_faults: Vec::new(),
        trip_start: None,
        stage: Stage::Mapping,
        input: job.input(),
        processed_at: now,
        route_id,
    };
    assert_eq!(
        store.apply_result(result).await.unwrap(),
        Applied::Committed
    );
    store.close().await.unwrap();
}

fn node(id: i64) -> NodeWithScan {
    let lidar = Lidar {
        angle_min_rad: -3.0,
        angle_increment_rad: 0.78,
        range_min_m: 0.05,
        range_max_m: 20.0,
        mount: Pose2::new(0.2, 0.0, 0.0),
        range_sigma_m: 0.01,
        band: None,
    };
    let ranges = [
        Some(2.0),
        Some(2.1),
        Some(2.2),
        None,
        Some(2.4),
        Some(2.5),
        Some(2.6),
        Some(2.7),
    ];
    let scan = LaserScan::new(Arc::new(lidar), ranges).unwrap();
    NodeWithScan {
        node: NodeRecord {
            id: NodeId(id),
            batch_id: BatchId::new("b-0").unwrap(),
            vehicle_id: VehicleId::new("agv-07").unwrap(),
            trip_id: TripId::new("trip-1").unwrap(),
            stamp: StampNs(1_795_154_399_000_000_000 + id * 1_000_000_000),
            pose: Pose2::new(0.5 * (id - 1) as f64, 0.0, 0.0),
            sigma: (id != 3).then(|| PoseSigma {
                x_m: 0.01 * (id - 1) as f64,
                y_m: 0.02 * (id - 1) as f64,
                theta_rad: 0.005 * (id - 1) as f64,
            }),
            odom_from_base: Pose2::new(0.5 * (id - 1) as f64, 0.0, 0.0),
            drift_m: 0.0,
            reference: true,
            active: true,
            subgraph_id: Some(1),
            trip_order: 0,
            client_id: None,
        },
        scan: Some(encode_scan(&scan).unwrap()),
        lidar: None,
        intermediate: Vec::new(),
    }
}

/// A scan between keyframes, without the ranges.
fn intermediate(node: i64, place: u32) -> NewIntermediate {
    let keyframe_from_base = Pose2::new(0.125 * f64::from(place + 1), 0.0, 0.0);
    let stamp = 1_795_154_399_000_000_000 + node * 1_000_000_000;
    NewIntermediate {
        node_id: NodeId(node),
        place,
        scan: IntermediateRecord {
            stamp: StampNs(stamp + 250_000_000 * i64::from(place + 1)),
            keyframe_from_base,
            odom_from_base: keyframe_from_base,
            companion: None,
            lends: false,
            scan: None,
        },
    }
}

fn edge(id: i64, from: i64, to: i64, kind: EdgeKind) -> EdgeRecord {
    let measurement = Pose2::new(0.5 * (to - from) as f64, 0.0, 0.0);
    let information = Information::from_sigmas(0.01, 0.005);
    EdgeRecord {
        id: EdgeId(id),
        from: NodeId(from),
        to: NodeId(to),
        kind,
        status: EdgeStatus::Active,
        batch_id: BatchId::new("b-0").unwrap(),
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
