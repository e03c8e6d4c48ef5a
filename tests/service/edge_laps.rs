//! Laps of a vehicle that matches scans on board: nodes and noisy edges, and no scans.

use std::f64::consts::TAU;

use mapshift::geometry::{Information, Pose2};
use mapshift::graph::{Edge, EdgeKind, EdgeStatus, Node, PoseGraph};
use mapshift::ids::{EdgeId, NodeId};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

/// Nodes of a lap.
pub const LAP: usize = 40;
/// Radius of the way, metres: nodes are about 1 m apart.
const RADIUS_M: f64 = 6.4;
/// Standard deviations of odometry and of closures: metres, radians.
const ODOMETRY_SIGMA: (f64, f64) = (0.01, 0.003);
const CLOSURE_SIGMA: (f64, f64) = (0.02, 0.006);

/// What a vehicle sends of one motion.
#[derive(Debug, Clone)]
pub struct Motion {
    pub from: usize,
    pub to: usize,
    pub measurement: Pose2,
    pub information: Information,
    pub kind: EdgeKind,
}

/// Some laps of one vehicle; node k is the k-th of the drive.
#[derive(Debug, Clone)]
pub struct Laps {
    pub vehicle: String,
    pub truth: Vec<Pose2>,
    pub motions: Vec<Motion>,
}

/// Where closures are off: from a lap on, at these places of it.
#[derive(Debug, Clone)]
pub struct Displaced {
    pub laps: std::ops::Range<usize>,
    pub places: std::ops::Range<usize>,
    pub by: Pose2,
}

impl Displaced {
    pub fn nowhere() -> Self {
        Self {
            laps: 0..0,
            places: 0..0,
            by: Pose2::IDENTITY,
        }
    }
}

struct Noise(ChaCha8Rng);

impl Noise {
    fn gaussian(&mut self) -> f64 {
        let (u, v) = (1.0 - self.0.random::<f64>(), self.0.random::<f64>());
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }

    fn pose(&mut self, (xy, theta): (f64, f64)) -> Pose2 {
        let [x, y, turn] = [xy, xy, theta].map(|sigma| sigma * self.gaussian());
        Pose2::new(x, y, turn)
    }
}

impl Laps {
    /// Laps round a circle. From the second one on each node is tied to the same of the first.
    pub fn drive(vehicle: &str, laps: usize, seed: u64, displaced: &Displaced) -> Self {
        let mut noise = Noise(ChaCha8Rng::seed_from_u64(seed));
        let on_circle = |k: usize| {
            let turned = TAU * k as f64 / LAP as f64;
            let (sin, cos) = turned.sin_cos();
            Pose2::new(RADIUS_M * sin, RADIUS_M * (1.0 - cos), turned)
        };
        let stray = |noise: &mut Noise| noise.pose((0.1, 0.05));
        let truth: Vec<Pose2> = (0..laps * LAP)
            .map(|k| match k {
                0 => on_circle(0),
                _ => on_circle(k).compose(&stray(&mut noise)),
            })
            .collect();
        let mut motions = Vec::new();
        for k in 1..truth.len() {
            let error = noise.pose(ODOMETRY_SIGMA);
            motions.push(Motion {
                from: k - 1,
                to: k,
                measurement: truth[k - 1].between(&truth[k]).compose(&error),
                information: Information::from_sigmas(ODOMETRY_SIGMA.0, ODOMETRY_SIGMA.1),
                kind: EdgeKind::Odometry,
            });
            let (lap, place) = (k / LAP, k % LAP);
            if lap > 0 {
                let error = noise.pose(CLOSURE_SIGMA);
                let is_off = displaced.laps.contains(&lap) && displaced.places.contains(&place);
                let by = if is_off {
                    displaced.by
                } else {
                    Pose2::IDENTITY
                };
                motions.push(Motion {
                    from: place,
                    to: k,
                    measurement: truth[place].between(&truth[k]).compose(&error).compose(&by),
                    information: Information::from_sigmas(CLOSURE_SIGMA.0, CLOSURE_SIGMA.1),
                    kind: EdgeKind::LoopClosure,
                });
            }
        }
        Self {
            vehicle: vehicle.to_owned(),
            truth,
            motions,
        }
    }

    /// The upload of nodes `from..to` with the edges that end there.
    pub fn batch(&self, nodes: std::ops::Range<usize>) -> Value {
        let pose = |p: &Pose2| json!({"x": p.x, "y": p.y, "theta": p.theta});
        let sent_nodes = nodes.clone().map(|k| {
            let stamp = jiff::Timestamp::from_second(1_795_000_000 + k as i64).unwrap();
            json!({"id": k, "pose": pose(&self.truth[k]), "stamp": stamp})
        });
        let ending = self.motions.iter().filter(|m| nodes.contains(&m.to));
        let edges = ending.map(|m| {
            let kind = match m.kind {
                EdgeKind::Odometry => "odometry",
                EdgeKind::LoopClosure => "loop_closure",
            };
            json!({
                "from": m.from.to_string(), "to": m.to.to_string(), "kind": kind,
                "measurement": pose(&m.measurement), "information": m.information.upper(),
            })
        });
        json!({
            "vehicle_id": self.vehicle,
            "trip_id": format!("{}-drive", self.vehicle),
            "nodes": sent_nodes.collect::<Vec<_>>(),
            "edges": edges.collect::<Vec<_>>(),
        })
    }

    /// The uploads of a batch a lap.
    pub fn batches(&self) -> Vec<Value> {
        let starts = (0..self.truth.len()).step_by(LAP);
        starts.map(|from| self.batch(from..from + LAP)).collect()
    }

    /// The whole drive as a graph that begins at the truth.
    pub fn graph(&self) -> PoseGraph {
        let mut graph = PoseGraph::new();
        for (k, pose) in self.truth.iter().enumerate() {
            let (id, pose) = (NodeId(k as i64), *pose);
            graph.add_node(Node { id, pose }).unwrap();
        }
        for (k, m) in self.motions.iter().enumerate() {
            let edge = Edge {
                id: EdgeId(k as i64),
                from: NodeId(m.from as i64),
                to: NodeId(m.to as i64),
                measurement: m.measurement,
                information: m.information,
                kind: m.kind,
                status: EdgeStatus::Active,
            };
            graph.add_edge(edge).unwrap();
        }
        graph
    }
}
