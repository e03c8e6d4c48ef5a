//! Shared by the tests of the store.

use std::sync::LazyLock;
use std::time::Duration;

use jiff::Timestamp;
use mapshift::geometry::{Information, Pose2, PoseSigma};
use mapshift::graph::{EdgeKind, EdgeStatus};
use mapshift::ids::{BatchId, EdgeId, LidarId, NodeId, RouteId, StampNs, TripId, VehicleId};
use mapshift::model::{Actor, BatchStatus, Stage};
use mapshift::store::{
    BatchContent, BatchOutcome, BatchRecord, ClaimedJob, EdgeRecord, IntermediateRecord, JobResult,
    Journaled, NewBatch, NewIntermediate, NodeRecord, NodeWithScan, RouteUpdate, Store,
    StoreOptions,
};
use sqlx::{Connection, SqliteConnection};
use tempfile::TempDir;

pub const LEASE: Duration = Duration::from_secs(60);

/// A store with the route `r`, and its directory.
pub struct Fixture {
    pub store: Store,
    pub directory: TempDir,
}

impl Fixture {
    pub async fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let store = open(&directory).await;
        put_route(&store, "r").await;
        Self { store, directory }
    }

    /// A second connection to the file, past the store: only for what is about SQLite itself.
    pub async fn raw(&self) -> SqliteConnection {
        let path = self.directory.path().join("mapshift.db");
        SqliteConnection::connect(path.to_str().unwrap())
            .await
            .unwrap()
    }

    pub async fn journal(&self, batch: NewBatch) -> Journaled {
        self.store.journal_batch(batch).await.unwrap()
    }

    pub async fn batch(&self, id: &str) -> BatchRecord {
        let id = BatchId::new(id).unwrap();
        self.store.batch(&route(), &id).await.unwrap().unwrap()
    }

    pub async fn status(&self, id: &str) -> BatchStatus {
        self.batch(id).await.status
    }

    pub async fn claim(&self, seconds: i64) -> Option<ClaimedJob> {
        self.store.claim_job(at(seconds), LEASE).await.unwrap()
    }

    /// The job that a process was lost with: not in the first second after the start.
    pub async fn claim_lost(&self) -> ClaimedJob {
        loop {
            if let Some(job) = self.claim(0).await {
                return job;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    pub async fn revision(&self, route: &RouteId) -> i64 {
        self.store.route(route).await.unwrap().unwrap().revision
    }

    /// What ends all batches of a job alike, without nodes.
    pub async fn result(&self, job: &ClaimedJob, status: BatchStatus) -> JobResult {
        let outcome = |entry: &mapshift::store::JournalEntry| BatchOutcome {
            batch_id: entry.batch.id.clone(),
            status,
            reason: None,
            flags: vec![],
            nodes_added: 0,
            loop_closures: 0,
        };
        JobResult {
            job_id: job.job_id,
            generation: job.generation,
            route_id: job.route_id.clone(),
            base_revision: self.revision(&job.route_id).await,
            outcomes: job.entries.iter().map(outcome).collect(),
            nodes: vec![],
            intermediate: vec![],
            edges: vec![],
            changed_nodes: vec![],
            changed_edges: vec![],
            alerts: vec![],
            calibrations: Vec::new(),
            clock_faults: Vec::new(),
            trip_start: None,
            stage: Stage::Mapping,
            input: job.input(),
            processed_at: at(50),
        }
    }

    /// A merged result with a chain of `count` nodes of the job's own batch.
    pub async fn chain(&self, job: &ClaimedJob, count: i64) -> JobResult {
        let graph = self.store.load_graph(&job.route_id).await.unwrap().unwrap();
        let mut result = self.result(job, BatchStatus::Merged).await;
        let own = &job.entries.last().unwrap().batch;
        for k in 0..count {
            let id = graph.next_node_id.0 + k;
            result.nodes.push(node(own, id));
            if k > 0 {
                let edge_id = graph.next_edge_id.0 + k - 1;
                result.edges.push(edge(own, edge_id, id - 1, id));
            }
        }
        result.outcomes.last_mut().unwrap().nodes_added = count;
        result
    }
}

/// What every store of the suite is opened with: another backend would be chosen here.
pub fn options(directory: &TempDir) -> StoreOptions {
    StoreOptions {
        data_dir: directory.path().to_path_buf(),
    }
}

pub async fn open(directory: &TempDir) -> Store {
    Store::open(options(directory)).await.unwrap()
}

pub async fn put_route(store: &Store, id: &str) {
    let id = RouteId::new(id).unwrap();
    store
        .put_route(&id, RouteUpdate::default(), by(), at(0))
        .await
        .unwrap();
}

pub fn at(seconds: i64) -> Timestamp {
    Timestamp::from_second(1_800_000_000 + seconds).unwrap()
}

/// Who makes the changes of these tests.
pub fn by() -> &'static Actor {
    static BY: LazyLock<Actor> = LazyLock::new(|| Actor::Local {
        address: "192.0.2.7".to_owned(),
    });
    &BY
}

pub fn route() -> RouteId {
    RouteId::new("r").unwrap()
}

pub fn batch_id(id: &str) -> BatchId {
    BatchId::new(id).unwrap()
}

/// An upload of vehicle `v` to route `r` at second 0, with the id as body.
pub fn upload(id: &str, trip: &str, sequence: i64) -> NewBatch {
    NewBatch {
        route_id: route(),
        id: batch_id(id),
        vehicle_id: VehicleId::new("v").unwrap(),
        trip_id: TripId::new(trip).unwrap(),
        content: BatchContent::Scans { sequence, scans: 3 },
        flags: vec!["noted".to_owned()],
        out_of_range: None,
        extensions: None,
        body: id.as_bytes().to_vec(),
        received_at: at(0),
    }
}

pub fn node(batch: &BatchRecord, id: i64) -> NodeWithScan {
    let node = NodeRecord {
        id: NodeId(id),
        batch_id: batch.id.clone(),
        vehicle_id: batch.vehicle_id.clone(),
        trip_id: batch.trip_id.clone(),
        stamp: StampNs(1_000 * id),
        pose: Pose2::new(id as f64 / 3.0, -0.1, std::f64::consts::PI),
        sigma: (id % 4 != 0).then(|| PoseSigma {
            x_m: id as f64 / 7.0,
            y_m: 1e-300,
            theta_rad: 0.1,
        }),
        odom_from_base: Pose2::new(0.0, id as f64, -3.1),
        drift_m: id as f64,
        reference: id % 2 == 0,
        active: true,
        subgraph_id: (id % 3 == 0).then_some(id),
        trip_order: (id % 1_000) as u32,
        client_id: None,
    };
    NodeWithScan {
        node,
        scan: Some(id.to_le_bytes().to_vec()),
        lidar: (id % 2 == 0).then(|| LidarId::new("front").unwrap()),
        intermediate: vec![],
    }
}

/// The scan at a place behind a node; every third one is not kept.
pub fn intermediate(node: i64, place: u32) -> NewIntermediate {
    let scan = IntermediateRecord {
        stamp: StampNs(1_000 * node + 1 + i64::from(place)),
        keyframe_from_base: Pose2::new(f64::from(place) / 7.0, -1e-300, 0.1 + 0.2),
        odom_from_base: Pose2::new(1.0 / 3.0, node as f64, std::f64::consts::PI),
        companion: (place % 2 == 1).then(|| LidarId::new("rear").unwrap()),
        lends: place == 1,
        scan: (place % 3 != 2).then(|| vec![node as u8, place as u8]),
    };
    NewIntermediate {
        node_id: NodeId(node),
        place,
        scan,
    }
}

pub fn edge(batch: &BatchRecord, id: i64, from: i64, to: i64) -> EdgeRecord {
    EdgeRecord {
        id: EdgeId(id),
        from: NodeId(from),
        to: NodeId(to),
        kind: EdgeKind::Odometry,
        status: EdgeStatus::Active,
        batch_id: batch.id.clone(),
        measurement: Pose2::new(0.1 + 0.2, 1e-300, -1.0),
        information: Information::from_upper([4.0, 0.5, -0.25, 3.0, 0.125, 9.0]),
        residual: 0.0,
        subgraph_id: None,
        delta_f: None,
        closure: None,
    }
}

/// Edges as they are read: with the residuals that the poses of their nodes make.
pub fn with_residuals(mut edges: Vec<EdgeRecord>, nodes: &[NodeRecord]) -> Vec<EdgeRecord> {
    let pose = |id: NodeId| nodes.iter().find(|node| node.id == id).unwrap().pose;
    for edge in &mut edges {
        let error = Pose2::edge_error(&pose(edge.from), &pose(edge.to), &edge.measurement);
        edge.residual = edge.information.squared_norm(&error);
    }
    edges
}
