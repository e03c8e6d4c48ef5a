//! The body of an upload of edges.

use std::collections::BTreeMap;

use serde::Serialize;

use super::batch_body::EncodedBatch;
use crate::graph::{Edge, EdgeKind, Node, PoseGraph};
use crate::ids::{NodeId, TripId, VehicleId};
use crate::ingest::edges_json::EDGES_MAX;
use crate::ingest::{PoseJson, pose_json};
use crate::model::BatchKind;

/// A graph cut into batches.
pub struct GraphParts {
    /// For each batch its nodes, by id, and the edges whose nodes are complete with it.
    parts: Vec<(Vec<Node>, Vec<Edge>)>,
}

impl GraphParts {
    /// Cuts a graph into runs of `part_nodes` nodes by id. An edge goes with the later of its
    /// nodes, in the graph's order of edges.
    ///
    /// # Errors
    /// If a part has more edges than a batch may have.
    pub fn of(graph: &PoseGraph, part_nodes: usize) -> anyhow::Result<Self> {
        let mut nodes = graph.nodes().to_vec();
        nodes.sort_by_key(|node| node.id);
        let ids = nodes.iter().enumerate();
        let places: BTreeMap<NodeId, usize> = ids.map(|(k, node)| (node.id, k)).collect();
        let runs = nodes.chunks(part_nodes);
        let mut parts: Vec<_> = runs.map(|run| (run.to_vec(), Vec::new())).collect();
        for edge in graph.edges() {
            let place = [edge.from, edge.to]
                .iter()
                .filter_map(|id| places.get(id))
                .max();
            if let Some(place) = place {
                parts[place / part_nodes].1.push(*edge);
            }
        }
        for (nodes, edges) in &parts {
            anyhow::ensure!(
                edges.len() <= EDGES_MAX,
                "{} edges end at nodes {} to {}, but a batch has at most {EDGES_MAX}: choose \
                 fewer nodes with --batch-nodes",
                edges.len(),
                nodes[0].id,
                nodes[nodes.len() - 1].id,
            );
        }
        Ok(Self { parts })
    }

    /// The batches in order, each with its number of nodes.
    pub fn encode(
        &self,
        vehicle_id: &VehicleId,
        trip_id: &TripId,
    ) -> impl Iterator<Item = anyhow::Result<(EncodedBatch, usize)>> {
        let parts = self.parts.iter().enumerate();
        parts.map(|(sequence, (nodes, edges))| {
            let body = EdgeBatchJson {
                vehicle_id: vehicle_id.as_str(),
                trip_id: trip_id.as_str(),
                nodes: nodes.iter().map(node_json).collect(),
                edges: edges.iter().map(edge_json).collect(),
            };
            let batch = EncodedBatch::of(BatchKind::Edges, trip_id, sequence, &body)?;
            Ok((batch, nodes.len()))
        })
    }
}

#[derive(Serialize)]
struct EdgeBatchJson<'a> {
    vehicle_id: &'a str,
    trip_id: &'a str,
    nodes: Vec<NodeJson>,
    edges: Vec<EdgeJson>,
}

#[derive(Serialize)]
struct NodeJson {
    id: i64,
    pose: PoseJson,
}

#[derive(Serialize)]
struct EdgeJson {
    from: i64,
    to: i64,
    measurement: PoseJson,
    information: [f64; 6],
    kind: EdgeKind,
}

fn node_json(node: &Node) -> NodeJson {
    NodeJson {
        id: node.id.0,
        pose: pose_json(&node.pose),
    }
}

fn edge_json(edge: &Edge) -> EdgeJson {
    EdgeJson {
        from: edge.from.0,
        to: edge.to.0,
        measurement: pose_json(&edge.measurement),
        information: edge.information.upper(),
        kind: edge.kind,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::edges_json::{NodeName, decode};
    use crate::ingest::g2o::read_g2o;
    use std::io::Read;

    const GRAPH: &str = "\
VERTEX_SE2 9 3 0 0
VERTEX_SE2 1 0 0 0
VERTEX_SE2 2 1 0 0.1
VERTEX_SE2 3 2 0 0
EDGE_SE2 9 1 -3 0 0 4 0.5 -0.25 3 0.125 9
EDGE_SE2 1 2 1 0 0.1 1 0 0 1 0 1
EDGE_SE2 2 3 1 0 -0.1 1 0 0 1 0 1
EDGE_SE2 3 1 -2 0 0 1 0 0 1 0 1
";

    #[test]
    fn a_graph_is_cut_by_its_nodes_and_read_as_it_was() {
        let graph = read_g2o(GRAPH).unwrap().graph;
        let parts = GraphParts::of(&graph, 3).unwrap();
        let (vehicle, trip) = (VehicleId::new("v").unwrap(), TripId::new("g").unwrap());
        let encoded: Vec<_> = parts.encode(&vehicle, &trip).map(Result::unwrap).collect();
        let reported: Vec<_> = encoded.iter().map(|(b, n)| (b.id.as_str(), *n)).collect();
        assert_eq!(reported, [("g-00000", 3), ("g-00001", 1)]);
        let mut decoded = encoded.iter().map(|(batch, _)| {
            let mut json = Vec::new();
            let mut decoder = flate2::read::GzDecoder::new(batch.gzip.as_slice());
            decoder.read_to_end(&mut json).unwrap();
            decode(&json, jiff::Timestamp::UNIX_EPOCH).unwrap()
        });
        let first = decoded.next().unwrap();
        let names: Vec<&str> = first.nodes.iter().map(|n| n.name.as_str()).collect();
        assert_eq!(names, ["1", "2", "3"]);
        let kinds: Vec<EdgeKind> = first.edges.iter().map(|e| e.kind).collect();
        use EdgeKind::{LoopClosure, Odometry};
        assert_eq!(kinds, [Odometry, Odometry, LoopClosure]);
        let last = decoded.next().unwrap();
        let own = |name: &str| NodeName::Own(name.to_owned());
        assert_eq!(
            (&last.edges[0].from, &last.edges[0].to),
            (&own("9"), &own("1"))
        );
        assert_eq!(last.edges[0].information, graph.edges()[0].information);
        assert_eq!(last.edges[0].measurement, graph.edges()[0].measurement);
        assert_eq!(last.nodes[0].pose, graph.nodes()[0].pose);
    }
}
