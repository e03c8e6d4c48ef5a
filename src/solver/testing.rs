//! Random graphs for tests.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::geometry::{Information, Pose2, Vector3};
use crate::graph::{Edge, EdgeKind, EdgeStatus, Node, PoseGraph};
use crate::ids::{EdgeId, NodeId};

fn noisy(rng: &mut ChaCha8Rng, pose: &Pose2, sigma: f64) -> Pose2 {
    let mut noise = || (rng.random::<f64>() - 0.5) * 3.4 * sigma;
    pose.compose(&Pose2::exp(&Vector3::new(noise(), noise(), noise() * 0.3)))
}

fn information(rng: &mut ChaCha8Rng) -> Information {
    let mut entry = || rng.random::<f64>() - 0.5;
    let a = nalgebra::Matrix3::from_fn(|_, _| entry());
    Information::from_matrix(&((a * a.transpose() + nalgebra::Matrix3::identity()) * 100.0))
}

/// A drive around a square, its nodes a little off the truth, broken once so that the graph has
/// two components, with noisy closures between nodes that are not neighbours.
pub(crate) fn random_graph(seed: u64, nodes: usize, closures: usize) -> PoseGraph {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut graph = PoseGraph::new();
    let mut truth = Pose2::new(3.0, -2.0, 0.4);
    for k in 0..nodes {
        let id = NodeId(10 * k as i64);
        let pose = noisy(&mut rng, &truth, 0.05);
        graph.add_node(Node { id, pose }).unwrap();
        truth = truth.compose(&Pose2::new(1.0, 0.0, if k % 5 == 4 { 1.57 } else { 0.0 }));
    }
    let gap = nodes * 4 / 5;
    for k in (1..nodes).filter(|&k| k != gap) {
        add_edge(&mut graph, &mut rng, k - 1, k, EdgeKind::Odometry);
    }
    for _ in 0..closures {
        let (a, b) = (rng.random_range(0..gap), rng.random_range(0..gap));
        if a != b {
            add_edge(&mut graph, &mut rng, a, b, EdgeKind::LoopClosure);
        }
    }
    graph
}

/// One more closure between any two nodes.
pub(crate) fn add_closure(graph: &mut PoseGraph, seed: u64) -> EdgeId {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let nodes = graph.nodes().len();
    let from = rng.random_range(0..nodes);
    let to = (from + rng.random_range(1..nodes)) % nodes;
    add_edge(graph, &mut rng, from, to, EdgeKind::LoopClosure)
}

fn add_edge(
    graph: &mut PoseGraph,
    rng: &mut ChaCha8Rng,
    from: usize,
    to: usize,
    kind: EdgeKind,
) -> EdgeId {
    let (from, to) = (graph.nodes()[from], graph.nodes()[to]);
    let id = EdgeId(graph.edges().len() as i64);
    let measurement = noisy(rng, &from.pose.between(&to.pose), 0.05);
    let edge = Edge {
        id,
        from: from.id,
        to: to.id,
        measurement,
        information: information(rng),
        kind,
        status: EdgeStatus::Active,
    };
    graph.add_edge(edge).unwrap();
    id
}
