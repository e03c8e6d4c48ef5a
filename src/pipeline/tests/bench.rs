//! A route through a small workshop in which a box is put down.

use std::collections::BTreeMap;
use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use super::super::alerts::fold_into;
use super::super::engine::Engine;
use super::super::process::process;
use super::super::refusal::Processed;
use super::super::trip_start::known_start;
use super::super::worker::compute;
use super::super::workspace::Workspace;
use super::super::{Decisions, Order, PipelineOptions};
use crate::change::{AlertAction, ChangeKind, Finding, Tier};
use crate::geometry::{Pose2, Vector2};
use crate::graph::EdgeKind;
use crate::ids::{BatchId, NodeId, RouteId, StampNs, TripId, VehicleId};
use crate::ingest::g2o::write_g2o;
use crate::mapping::{IntermediateScan, Mending};
use crate::model::{Actor, DismissReason};
use crate::render::{Decided, MapPicture, PosedScan};
use crate::sim::{OdometryError, Route, Shape, SimLidar, Vehicle, World, drive};
use crate::solver::Interrupt;
use crate::store::{
    AlertFilter, AlertRecord, Applied, BatchContent, BatchRecord, EdgeRecord, Journaled, NewBatch,
    NodeRecord, RouteUpdate, Store, StoreOptions, fsck,
};

/// Where the box is put down.
pub const BOX_AT: Vector2<f64> = Vector2::new(6.0, 0.6);

pub struct Bench {
    pub engine: Engine,
    pub decisions: Decisions,
    directory: TempDir,
}

/// What a route's map is, to the bit.
#[derive(Debug, PartialEq)]
pub struct MapState {
    pub nodes: Vec<NodeRecord>,
    pub edges: Vec<EdgeRecord>,
    pub g2o: String,
    pub pgm: Vec<u8>,
    /// Of the nodes in the map.
    pub intermediate: BTreeMap<NodeId, Vec<IntermediateScan>>,
}

impl Bench {
    pub async fn new() -> Self {
        let directory = TempDir::new().unwrap();
        let bench = Self::open(directory).await;
        let update = RouteUpdate::default();
        let store = &bench.engine.store;
        let made = store
            .put_route(&route(), update, &Actor::System, at(0))
            .await;
        made.unwrap();
        bench
    }

    async fn open(directory: TempDir) -> Self {
        let data_dir = directory.path().to_path_buf();
        let store = Store::open(StoreOptions { data_dir }).await.unwrap();
        let engine = Engine::new(&store, PipelineOptions::default()).unwrap();
        Self {
            decisions: Decisions::new(engine.clone()),
            engine,
            directory,
        }
    }

    pub async fn restarted(self) -> Self {
        let Self {
            engine,
            decisions,
            directory,
        } = self;
        let store = engine.store.clone();
        drop((engine, decisions));
        store.close().await.unwrap();
        Self::open(directory).await
    }

    /// A map of two laps, and one alert that a third lap raises.
    pub async fn with_alert() -> (Self, AlertRecord) {
        let bench = Self::new().await;
        bench.lap("before", 0, 2, |_| Vec::new()).await;
        bench.lap("after", 1, 1, |map| vec![box_finding(map)]).await;
        let alert = bench.alerts().await.remove(0);
        (bench, alert)
    }

    /// Drives laps and merges them; from hour 1 on the box is there.
    pub async fn lap(
        &self,
        trip: &str,
        hour: i64,
        laps: usize,
        findings: impl Fn(&Workspace) -> Vec<Finding>,
    ) {
        self.mended_lap(trip, hour, laps, |map| (findings(map), Vec::new()))
            .await;
    }

    /// As [`Self::lap`], where something was mended too.
    pub async fn mended_lap(
        &self,
        trip: &str,
        hour: i64,
        laps: usize,
        observed: impl Fn(&Workspace) -> (Vec<Finding>, Vec<Mending>),
    ) {
        let store = &self.engine.store;
        let journaled = store.journal_batch(upload(trip, hour, laps)).await;
        assert_eq!(journaled.unwrap(), Journaled::Stored);
        let lease = std::time::Duration::from_secs(60);
        let job = store
            .claim_job(Timestamp::now(), lease)
            .await
            .unwrap()
            .unwrap();
        let workspace = self.engine.workspaces.take(store, &route()).await.unwrap();
        // What a detector says of the lap is set aside: here findings are made by hand.
        let alerts = workspace.alerts.clone();
        let known = known_start(store, &workspace, &job).await.unwrap();
        let Processed::Taken(taken) = process(workspace, &job, &known).unwrap() else {
            panic!("the lap was refused");
        };
        let (mut workspace, mut result) = *taken;
        workspace.alerts = alerts;
        let (findings, mendings) = observed(&workspace);
        result.alerts = fold_into(&mut workspace, &job.route_id, &findings, &mendings, job.at);
        assert_eq!(
            store.apply_result(result).await.unwrap(),
            Applied::Committed
        );
        self.engine.workspaces.put_back(route(), workspace.saved());
    }

    /// Merges an upload as a worker does, detector and all. Of the newest segments `segments`
    /// stay in the map, and the first one.
    pub async fn merge(&self, batch: NewBatch, segments: usize) -> BatchRecord {
        let mut engine = self.engine.clone();
        engine.options.active_segments = segments;
        engine.options.first_segments = 1;
        let (store, id) = (&engine.store, batch.id.clone());
        store.journal_batch(batch).await.unwrap();
        let lease = std::time::Duration::from_secs(60);
        let job = store
            .claim_job(Timestamp::now(), lease)
            .await
            .unwrap()
            .unwrap();
        let (workspace, result) = compute(&engine, &Arc::new(job), &Interrupt::default())
            .await
            .unwrap();
        let applied = store.apply_result(result).await.unwrap();
        assert_eq!(applied, Applied::Committed);
        engine.workspaces.put_back(route(), workspace.saved());
        store.batch(&route(), &id).await.unwrap().unwrap()
    }

    pub async fn alerts(&self) -> Vec<AlertRecord> {
        let filter = AlertFilter::default();
        self.engine
            .store
            .alert_page(&filter, None, 100)
            .await
            .unwrap()
    }

    pub fn order(alert: &AlertRecord, action: AlertAction) -> Order {
        Order {
            alert_id: alert.id,
            decision_revision: alert.decision_revision,
            action,
            actor: Actor::Local {
                address: "192.0.2.7".to_owned(),
            },
            by: "keeper".to_owned(),
            note: Some("seen with my own eyes".to_owned()),
            reason: (action == AlertAction::Dismiss).then_some(DismissReason::Temporary),
            at: Timestamp::now(),
        }
    }

    pub async fn decide(&self, alert: &AlertRecord, action: AlertAction) -> AlertRecord {
        self.decisions
            .decide(Self::order(alert, action))
            .await
            .unwrap()
    }

    /// What the map is; whatever has happened to it, the database is sound.
    pub async fn state(&self) -> MapState {
        let store = &self.engine.store;
        let report = fsck(self.directory.path(), false, &|_, _| {}).await;
        let report = report.unwrap();
        assert!(report.sound, "{:?}", report.faults);
        let workspace = self.engine.workspaces.take(store, &route()).await.unwrap();
        let g2o = write_g2o(workspace.map.graph());
        let keyframes = workspace.map.keyframes().iter();
        let intermediate = keyframes.map(|keyframe| (keyframe.node, keyframe.intermediate.clone()));
        let intermediate = intermediate.collect();
        self.engine.workspaces.put_back(route(), workspace);
        MapState {
            intermediate,
            nodes: store.nodes(&route()).await.unwrap(),
            edges: store.edges(&route()).await.unwrap(),
            g2o,
            pgm: self.picture().await.pgm,
        }
    }

    /// The map's picture as it is drawn from what is stored.
    pub async fn picture(&self) -> MapPicture {
        let store = &self.engine.store;
        let nodes = store.nodes_with_scans(&route()).await.unwrap();
        let accepted = store.accepted_changes(&route()).await.unwrap();
        let scans = nodes.iter().flat_map(|node| node.decoded_scans().unwrap());
        let scans: Vec<_> = scans.collect();
        let scans = scans.iter().map(|(stamp, map_from_base, scan)| PosedScan {
            stamp: *stamp,
            map_from_base: *map_from_base,
            scan,
            untied: None,
        });
        let pending = store.pending_changes(&route()).await.unwrap();
        let decided = Decided {
            accepted: &accepted,
            pending: &pending,
        };
        MapPicture::draw(scans, decided).unwrap()
    }
}

pub fn route() -> RouteId {
    RouteId::new("workshop").unwrap()
}

pub fn at(hour: i64) -> Timestamp {
    let start: Timestamp = "2026-11-20T06:00:00Z".parse().unwrap();
    start + SignedDuration::from_hours(hour)
}

pub fn stamp_of_hour(hour: i64) -> StampNs {
    StampNs(i64::try_from(at(hour).as_nanosecond()).unwrap())
}

pub fn sha256(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

fn rectangle(x: f64, y: f64, length: f64, width: f64) -> Shape {
    Shape::rectangle(&Pose2::new(x, y, 0.0), length, width)
}

fn world(with_box: bool) -> World {
    let shapes = [
        rectangle(6.0, 5.0, 13.0, 11.0),
        rectangle(4.5, 4.6, 2.0, 1.5),
        rectangle(6.5, 9.9, 5.0, 1.0),
        rectangle(12.0, 6.5, 0.8, 3.0),
        rectangle(8.2, 5.8, 0.6, 2.2),
    ];
    let added = with_box.then(|| rectangle(BOX_AT.x, BOX_AT.y, 0.6, 0.4));
    World::new(shapes.into_iter().chain(added))
}

fn vehicle() -> Vehicle {
    Vehicle {
        lidar: SimLidar::all_round(180, 20.0, 0.01, Pose2::new(0.2, 0.0, 0.0)),
        odometry: OdometryError {
            scale: 0.01,
            yaw_drift_rad_per_m: 5e-4,
            sigma_xy_m: 0.005,
            sigma_theta_rad: 0.003,
        },
        path_noise_m: 0.2,
        scan_spacing_m: 0.5,
        speed_mps: 1.2,
    }
}

/// A drive of its own as one upload; its id is the trip's.
pub fn upload(trip: &str, hour: i64, laps: usize) -> NewBatch {
    upload_part(trip, hour, laps, 0)
}

/// An hour's drive from its scan `from` on as one upload of a trip; but for the first one its id
/// is the trip's with that scan.
pub fn upload_part(trip: &str, hour: i64, laps: usize, from: usize) -> NewBatch {
    upload_spaced(trip, hour, laps, from, vehicle().scan_spacing_m)
}

/// As [`upload_part`], with another distance between scans, metres.
pub fn upload_spaced(
    trip: &str,
    hour: i64,
    laps: usize,
    from: usize,
    scan_spacing_m: f64,
) -> NewBatch {
    let corners = [(2.0, 2.0), (10.0, 2.0), (10.0, 8.0), (2.0, 8.0)];
    let corners = corners.map(|(x, y)| Vector2::new(x, y));
    let path = Route::new(&corners, 1.0).unwrap();
    let vehicle = Vehicle {
        scan_spacing_m,
        ..vehicle()
    };
    let scans = drive(
        &world(hour > 0),
        &path,
        &vehicle,
        laps,
        7 + hour.unsigned_abs(),
    );
    let pose = |p: &Pose2| json!({"x": p.x, "y": p.y, "theta": p.theta});
    let mut start = pose(&scans[0].map_from_base);
    start["sigma_xy"] = json!(0.1);
    start["sigma_theta"] = json!(0.03);
    let geometry = &vehicle.lidar.geometry;
    let scans = &scans[from..];
    let count = i64::try_from(scans.len()).unwrap();
    let (id, sequence) = match from {
        0 => (trip.to_owned(), 0),
        _ => (format!("{trip}-{from}"), 1),
    };
    let scans = scans.iter().map(|scan| {
        let after = SignedDuration::from_millis((scan.time_s * 1e3) as i64);
        json!({
            "stamp": at(hour) + after,
            "odometry": pose(&scan.odom_from_base),
            "ranges": scan.ranges_m,
        })
    });
    let body = json!({
        "vehicle_id": format!("agv-{hour}"), "trip_id": trip, "sequence": sequence,
        "initial_pose": start,
        "lidar": {
            "angle_min": geometry.angle_min_rad, "angle_increment": geometry.angle_increment_rad,
            "range_min": geometry.range_min_m, "range_max": geometry.range_max_m,
            "mount": pose(&geometry.mount), "range_sigma": geometry.range_sigma_m,
        },
        "scans": scans.collect::<Vec<Value>>(),
    });
    NewBatch {
        route_id: route(),
        id: BatchId::new(id).unwrap(),
        vehicle_id: VehicleId::new(format!("agv-{hour}")).unwrap(),
        trip_id: TripId::new(trip).unwrap(),
        content: BatchContent::Scans {
            sequence,
            scans: count,
        },
        flags: Vec::new(),
        out_of_range: None,
        extensions: None,
        body: serde_json::to_vec(&body).unwrap(),
        received_at: at(hour),
    }
}

/// What a detector would say of the box.
pub fn box_finding(workspace: &Workspace) -> Finding {
    finding_at(workspace, BOX_AT)
}

/// What a detector would say of a box at a place: nodes within 3 m, the closures between those before
/// and those after.
pub fn finding_at(workspace: &Workspace, place: Vector2<f64>) -> Finding {
    let graph = workspace.map.graph();
    let is_near = |node: NodeId| {
        let pose = graph.node(node).unwrap().pose;
        (pose.translation() - place).norm() < 3.0
    };
    let near = workspace.map.keyframes().iter().filter(|k| is_near(k.node));
    let near: Vec<_> = near.collect();
    let since = stamp_of_hour(1);
    let later = |node: NodeId| near.iter().any(|k| k.node == node && k.stamp >= since);
    let earlier = |node: NodeId| near.iter().any(|k| k.node == node && k.stamp < since);
    let edges = graph
        .edges()
        .iter()
        .filter(|edge| edge.kind == EdgeKind::LoopClosure && earlier(edge.from) && later(edge.to));
    let views: Vec<_> = near.iter().filter(|k| k.stamp >= since).collect();
    let mut trips: Vec<TripId> = views.iter().map(|k| k.trip.clone()).collect();
    trips.dedup();
    let corners = [[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]];
    Finding {
        tier: Tier::Confirmed,
        counterpart: None,
        shift: None,
        suspect: None,
        bands: Vec::new(),
        kind: ChangeKind::Appeared,
        location: place,
        sigma_m: 0.03,
        region: corners.map(|c| place + Vector2::from(c)).to_vec(),
        edges: edges.map(|edge| edge.id).collect(),
        nodes: near.iter().map(|k| k.node).collect(),
        laps: trips.len(),
        trips,
        views: views.len(),
        confidence: 0.99,
        since: views.iter().map(|k| k.stamp).min().unwrap(),
        last_seen: views.iter().map(|k| k.stamp).max().unwrap(),
        until: None,
    }
}
