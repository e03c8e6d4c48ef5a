//! The text format of g2o for planar pose graphs: `VERTEX_SE2`, `EDGE_SE2`, `FIX`.

use std::fmt::Write as _;
use std::num::{ParseFloatError, ParseIntError};

use crate::geometry::{Information, Pose2};
use crate::graph::{Edge, EdgeKind, EdgeStatus, GraphError, Node, PoseGraph};
use crate::ids::{EdgeId, NodeId};

/// Why a text is not a planar pose graph.
#[derive(Debug, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct G2oError {
    /// Counted from 1.
    pub line: usize,
    /// What is wrong there, with its cause.
    pub problem: G2oProblem,
}

/// What is wrong in a line.
#[derive(Debug, thiserror::Error)]
pub enum G2oProblem {
    /// Another kind of line, e.g. one of a spatial graph.
    #[error("{0:?} is not supported; a planar graph has VERTEX_SE2, EDGE_SE2 and FIX")]
    UnknownTag(String),
    /// Too few or too many fields.
    #[error("{tag} has {found} fields after it, not {expected}")]
    FieldCount {
        /// The line's first word.
        tag: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// An id is not a whole number.
    #[error("{field:?} is not a node's id (a whole number)")]
    Id {
        /// As it stands in the line.
        field: String,
        /// Why it was refused.
        #[source]
        cause: ParseIntError,
    },
    /// Not a number.
    #[error("{field:?} is not a number")]
    Number {
        /// As it stands in the line.
        field: String,
        /// Why it was refused.
        #[source]
        cause: ParseFloatError,
    },
    /// A number is infinite or not a number.
    #[error("{0:?} is not finite")]
    NotFinite(String),
    /// An information matrix has a negative eigenvalue.
    #[error("the information matrix is not positive semi-definite")]
    Information,
    /// The graph refused it.
    #[error(transparent)]
    Graph(#[from] GraphError),
}

/// A pose graph as it was read.
#[derive(Debug, Clone)]
pub struct G2oGraph {
    /// Nodes in the order of their lines, then nodes that only edges name, by id. Edge ids
    /// count the `EDGE_SE2` lines from 0. An edge from a node to the one with the next id is
    /// odometry, any other a loop closure.
    pub graph: PoseGraph,
    /// Nodes that no `VERTEX_SE2` line gave a pose; they stand at the origin.
    pub without_pose: Vec<NodeId>,
    /// Nodes that `FIX` lines name. The solver holds each component's first node whatever
    /// stands here.
    pub fixed: Vec<NodeId>,
}

/// Reads a graph. Lines that are empty, start with `#`, or hold a bare number are passed over.
///
/// # Errors
/// [`G2oError`] at the first line that is not understood.
pub fn read_g2o(text: &str) -> Result<G2oGraph, G2oError> {
    let mut reader = Reader::default();
    for (index, line) in text.lines().enumerate() {
        reader
            .read_line(index + 1, line)
            .map_err(|problem| G2oError {
                line: index + 1,
                problem,
            })?;
    }
    reader.finish()
}

#[derive(Default)]
struct Reader {
    graph: PoseGraph,
    edges: Vec<(usize, Edge)>,
    fixed: Vec<NodeId>,
}

impl Reader {
    fn read_line(&mut self, number: usize, line: &str) -> Result<(), G2oProblem> {
        let mut words = line.split_ascii_whitespace();
        let Some(tag) = words.next() else {
            return Ok(());
        };
        let fields: Vec<&str> = words.collect();
        match tag {
            "VERTEX_SE2" => {
                let [id, x, y, theta] = exactly("VERTEX_SE2", &fields)?;
                let node = Node {
                    id: node_id(id)?,
                    pose: pose([x, y, theta])?,
                };
                self.graph.add_node(node)?;
            }
            "EDGE_SE2" => {
                let edge = self.edge(exactly("EDGE_SE2", &fields)?)?;
                self.edges.push((number, edge));
            }
            "FIX" => {
                for field in fields {
                    self.fixed.push(node_id(field)?);
                }
            }
            _ if tag.starts_with('#') => {}
            // Some exporters leave a count alone in a line.
            _ if fields.is_empty() && tag.parse::<f64>().is_ok() => {}
            _ => return Err(G2oProblem::UnknownTag(tag.to_owned())),
        }
        Ok(())
    }

    fn edge(&self, fields: [&str; 11]) -> Result<Edge, G2oProblem> {
        let [from, to, x, y, theta, upper @ ..] = fields;
        let (from, to) = (node_id(from)?, node_id(to)?);
        let mut numbers = [0.0; 6];
        for (number, field) in numbers.iter_mut().zip(upper) {
            *number = finite(field)?;
        }
        let information = Information::from_upper(numbers);
        if !information.is_positive_semidefinite() {
            return Err(G2oProblem::Information);
        }
        Ok(Edge {
            id: EdgeId(self.edges.len() as i64),
            from,
            to,
            measurement: pose([x, y, theta])?,
            information,
            kind: if from.0.checked_add(1) == Some(to.0) {
                EdgeKind::Odometry
            } else {
                EdgeKind::LoopClosure
            },
            status: EdgeStatus::Active,
        })
    }

    fn finish(mut self) -> Result<G2oGraph, G2oError> {
        let ends = self.edges.iter().flat_map(|(_, e)| [e.from, e.to]);
        let mut without_pose: Vec<NodeId> =
            ends.filter(|&id| self.graph.node(id).is_none()).collect();
        without_pose.sort_unstable();
        without_pose.dedup();
        let at = |line| {
            move |problem: GraphError| G2oError {
                line,
                problem: problem.into(),
            }
        };
        for &id in &without_pose {
            let pose = Pose2::IDENTITY;
            self.graph.add_node(Node { id, pose }).map_err(at(0))?;
        }
        for (line, edge) in self.edges {
            self.graph.add_edge(edge).map_err(at(line))?;
        }
        Ok(G2oGraph {
            graph: self.graph,
            without_pose,
            fixed: self.fixed,
        })
    }
}

fn exactly<'a, const N: usize>(
    tag: &'static str,
    fields: &[&'a str],
) -> Result<[&'a str; N], G2oProblem> {
    <[&str; N]>::try_from(fields).map_err(|_| G2oProblem::FieldCount {
        tag,
        expected: N,
        found: fields.len(),
    })
}

fn node_id(field: &str) -> Result<NodeId, G2oProblem> {
    field.parse().map(NodeId).map_err(|cause| G2oProblem::Id {
        field: field.to_owned(),
        cause,
    })
}

fn finite(field: &str) -> Result<f64, G2oProblem> {
    let number: f64 = field.parse().map_err(|cause| G2oProblem::Number {
        field: field.to_owned(),
        cause,
    })?;
    if number.is_finite() {
        Ok(number)
    } else {
        Err(G2oProblem::NotFinite(field.to_owned()))
    }
}

fn pose(fields: [&str; 3]) -> Result<Pose2, G2oProblem> {
    let [x, y, theta] = fields;
    Ok(Pose2::new(finite(x)?, finite(y)?, finite(theta)?))
}

/// Writes a graph's nodes and active edges. Every number is read back to the bit.
pub fn write_g2o(graph: &PoseGraph) -> String {
    let mut text = String::new();
    for node in graph.nodes() {
        write_vertex(&mut text, node.id, &node.pose);
    }
    let active = graph.edges().iter();
    for edge in active.filter(|edge| edge.status == EdgeStatus::Active) {
        let ends = [edge.from, edge.to];
        write_edge(&mut text, ends, &edge.measurement, &edge.information);
    }
    text
}

/// Appends the line of a node at a pose.
pub fn write_vertex(text: &mut String, id: NodeId, pose: &Pose2) {
    // Writing to a string cannot fail.
    let _ = writeln!(text, "VERTEX_SE2 {id} {} {} {}", pose.x, pose.y, pose.theta);
}

/// Appends the line of an edge from the first of its ends to the second.
pub fn write_edge(
    text: &mut String,
    [from, to]: [NodeId; 2],
    measurement: &Pose2,
    information: &Information,
) {
    let m = measurement;
    // Writing to a string cannot fail.
    let _ = write!(text, "EDGE_SE2 {from} {to} {} {} {}", m.x, m.y, m.theta);
    for number in information.upper() {
        let _ = write!(text, " {number}");
    }
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SMALL: &str = "\
# a square
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.5 0 0.1

FIX 0
EDGE_SE2 0 1 1.5 0 0.1 4 0.5 -0.25 3 0.125 9
EDGE_SE2 1 0 -1.5 0 -0.1 1 0 0 1 0 1
EDGE_SE2 1 7 1 0 0 1 0 0 1 0 1
";

    #[test]
    fn reads_nodes_edges_and_kinds() {
        let read = read_g2o(SMALL).unwrap();
        let ids: Vec<i64> = read.graph.nodes().iter().map(|n| n.id.0).collect();
        assert_eq!(ids, [0, 1, 7]);
        assert_eq!(read.without_pose, [NodeId(7)]);
        assert_eq!(read.fixed, [NodeId(0)]);
        let kinds: Vec<EdgeKind> = read.graph.edges().iter().map(|e| e.kind).collect();
        use EdgeKind::{LoopClosure, Odometry};
        assert_eq!(kinds, [Odometry, LoopClosure, LoopClosure]);
        let upper = read.graph.edges()[0].information.upper();
        assert_eq!(upper, [4.0, 0.5, -0.25, 3.0, 0.125, 9.0]);
    }

    #[test]
    fn says_which_line_is_wrong_and_why() {
        let wrong = [
            (
                "VERTEX_SE2 0 0 0",
                "line 1: VERTEX_SE2 has 3 fields after it, not 4",
            ),
            ("\n\nVERTEX_SE2 0 0 x 0", "line 3: \"x\" is not a number"),
            ("VERTEX_SE2 0 0 inf 0", "line 1: \"inf\" is not finite"),
            (
                "VERTEX_SE2 a 0 0 0",
                "line 1: \"a\" is not a node's id (a whole number)",
            ),
            (
                "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1",
                "line 1: \"VERTEX_SE3:QUAT\" is not supported; a planar graph has VERTEX_SE2, EDGE_SE2 and FIX",
            ),
            (
                "VERTEX_SE2 4 0 0 0\nVERTEX_SE2 4 0 0 0",
                "line 2: node 4 is in the graph already",
            ),
            (
                "# x\nEDGE_SE2 1 1 0 0 0 1 0 0 1 0 1",
                "line 2: edge 0 joins a node to itself",
            ),
            (
                "EDGE_SE2 1 2 0 0 0 1 2 0 1 0 1",
                "line 1: the information matrix is not positive semi-definite",
            ),
        ];
        for (text, message) in wrong {
            assert_eq!(read_g2o(text).unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn an_empty_text_is_an_empty_graph() {
        let read = read_g2o("").unwrap();
        assert!(read.graph.nodes().is_empty());
        assert_eq!(write_g2o(&read.graph), "");
    }

    proptest! {
        #[test]
        fn round_trip_to_the_bit(
            poses in prop::collection::vec((-1e6..1e6_f64, -1e-6..1e6_f64, -3.2..3.2_f64), 2..20),
            sigma in 1e-4..10.0_f64,
        ) {
            let mut graph = PoseGraph::new();
            for (k, &(x, y, t)) in poses.iter().enumerate() {
                graph.add_node(Node { id: NodeId(k as i64), pose: Pose2::new(x, y, t) }).unwrap();
            }
            for k in 1..poses.len() {
                let (from, to) = (graph.nodes()[k - 1], graph.nodes()[k]);
                graph.add_edge(Edge {
                    id: EdgeId(k as i64 - 1),
                    from: from.id,
                    to: to.id,
                    measurement: from.pose.between(&to.pose),
                    information: Information::from_sigmas(sigma, sigma * 0.3),
                    kind: EdgeKind::Odometry,
                    status: EdgeStatus::Active,
                }).unwrap();
            }
            let again = read_g2o(&write_g2o(&graph)).unwrap().graph;
            prop_assert_eq!(again.nodes(), graph.nodes());
            prop_assert_eq!(again.edges(), graph.edges());
        }
    }
}
