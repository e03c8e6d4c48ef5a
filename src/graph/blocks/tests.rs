//! Blocks by depth-first search and by growth, against brute force and each other.

use proptest::prelude::*;

use super::*;
use crate::geometry::{Information, Pose2};
use crate::graph::{Edge, EdgeKind, EdgeStatus, Node, PoseGraph};
use crate::ids::NodeId;

fn graph(nodes: usize, ends: &[(usize, usize)]) -> PoseGraph {
    let mut graph = PoseGraph::new();
    for k in 0..nodes {
        let id = NodeId(k as i64);
        let pose = Pose2::IDENTITY;
        graph.add_node(Node { id, pose }).unwrap();
    }
    for (k, &(from, to)) in ends.iter().enumerate() {
        graph
            .add_edge(Edge {
                id: EdgeId(100 + k as i64),
                from: NodeId(from as i64),
                to: NodeId(to as i64),
                measurement: Pose2::IDENTITY,
                information: Information::identity(),
                kind: EdgeKind::LoopClosure,
                status: EdgeStatus::Active,
            })
            .unwrap();
    }
    graph
}

/// Two triangles that share node 2, a bridge to 5, and a parallel pair 5 = 6.
#[test]
fn a_graph_with_everything() {
    let ends = [
        (0, 1),
        (1, 2),
        (2, 0),
        (2, 3),
        (3, 4),
        (4, 2),
        (4, 5),
        (5, 6),
        (6, 5),
    ];
    let mut graph = graph(8, &ends);
    let blocks = graph.find_blocks();
    let names: Vec<_> = (0..9).map(|e| blocks.subgraph_of_edge(e)).collect();
    let id = |k: i64| Some(EdgeId(k));
    assert_eq!(
        names,
        [
            id(100),
            id(100),
            id(100),
            id(103),
            id(103),
            id(103),
            None,
            id(107),
            id(107)
        ]
    );
    let cuts: Vec<usize> = (0..8).filter(|&n| blocks.is_cut_node(n)).collect();
    assert_eq!(cuts, [2, 4, 5]);
    let of = |node| graph.subgraph_of_node(NodeId(node));
    assert_eq!(
        [of(2), of(4), of(5), of(6)],
        [id(100), id(103), id(107), id(107)]
    );
    assert_eq!(of(7), None);
    let second = blocks.get(blocks.of_edge(4).unwrap()).unwrap();
    let mut nodes = second.nodes.clone();
    nodes.sort_unstable();
    assert_eq!((second.anchor, nodes), (2, vec![3, 4]));

    graph.set_edge_status(EdgeId(104), EdgeStatus::Retired);
    let blocks = graph.find_blocks();
    assert_eq!(blocks.of_edge(4), None);
    let third = blocks.get(blocks.of_edge(3).unwrap()).unwrap();
    assert!(third.is_bridge());
}

#[test]
fn a_long_chain_does_not_overflow_the_stack() {
    let ends: Vec<_> = (0..100_000).map(|k| (k, k + 1)).collect();
    let blocks = graph(100_001, &ends).find_blocks();
    assert_eq!(blocks.iter().count(), 100_000);
}

/// Whether two nodes are joined without one node and without one edge.
fn joined(nodes: usize, ends: &[(usize, usize)], a: usize, b: usize, without: usize) -> bool {
    let mut reached = vec![false; nodes];
    reached[a] = true;
    for _ in 0..nodes {
        for &(from, to) in ends {
            if from != without && to != without && (reached[from] || reached[to]) {
                reached[from] = true;
                reached[to] = true;
            }
        }
    }
    reached[b]
}

/// Two edges are in one block if they lie on a common simple cycle: by brute force, if no
/// node's removal parts them (edges that share both ends are parallel).
fn share_a_block(nodes: usize, ends: &[(usize, usize)], e: usize, f: usize) -> bool {
    let parted_by = |cut: usize| {
        let side = |edge: (usize, usize)| if edge.0 == cut { edge.1 } else { edge.0 };
        !joined(nodes, ends, side(ends[e]), side(ends[f]), cut)
    };
    (0..=nodes).all(|cut| !parted_by(cut)) && !parted_by_an_edge(nodes, ends, e, f)
}

/// Whether e or f is a bridge.
fn parted_by_an_edge(nodes: usize, ends: &[(usize, usize)], e: usize, f: usize) -> bool {
    [e, f].into_iter().any(|bridge| {
        let mut rest = ends.to_vec();
        let (a, b) = rest.remove(bridge);
        !joined(nodes, &rest, a, b, nodes)
    })
}

proptest! {
    #[test]
    fn agrees_with_brute_force(
        nodes in 2..9_usize,
        raw in prop::collection::vec((0..9_usize, 0..9_usize), 1..14),
    ) {
        let ends: Vec<(usize, usize)> = raw
            .into_iter()
            .map(|(a, b)| (a % nodes, b % nodes))
            .filter(|(a, b)| a != b)
            .collect();
        let blocks = graph(nodes, &ends).find_blocks();
        for e in 0..ends.len() {
            prop_assert!(blocks.of_edge(e).is_some());
            for f in 0..e {
                let together = blocks.of_edge(e) == blocks.of_edge(f);
                prop_assert_eq!(together, share_a_block(nodes, &ends, e, f), "{:?} {} {}", ends, e, f);
            }
        }
        for block in blocks.iter() {
            prop_assert!(!block.nodes.contains(&block.anchor));
            let mut from_edges: Vec<usize> = block.edges.iter()
                .flat_map(|&e| [ends[e].0, ends[e].1])
                .filter(|&n| n != block.anchor)
                .collect();
            from_edges.sort_unstable();
            from_edges.dedup();
            let mut nodes = block.nodes.clone();
            nodes.sort_unstable();
            prop_assert_eq!(from_edges, nodes);
        }
        // Each component's blocks hang together at its first node.
        for node in 0..nodes {
            let components = (0..nodes).filter(|&n| joined(nodes, &ends, n, node, nodes));
            let first = components.min() == Some(node);
            prop_assert_eq!(first, blocks.towards_first[node].is_none());
        }
    }
}

/// A block by what it is, whatever its history.
type Form = (usize, Vec<usize>, Vec<usize>, Option<EdgeId>);

fn sorted(mut places: Vec<usize>) -> Vec<usize> {
    places.sort_unstable();
    places
}

fn form(block: &Block) -> Form {
    let (nodes, edges) = (sorted(block.nodes.clone()), sorted(block.edges.clone()));
    (block.anchor, nodes, edges, block.subgraph_id())
}

/// Blocks that say of every edge and node what those found by a new search say.
fn check_like_new(graph: &PoseGraph) {
    let (kept, anew) = (graph.blocks(), graph.find_blocks());
    let mut forms: Vec<Form> = kept.iter().map(form).collect();
    let mut forms_anew: Vec<Form> = anew.iter().map(form).collect();
    forms.sort_unstable();
    forms_anew.sort_unstable();
    assert_eq!(forms, forms_anew);
    let of = |blocks: &Blocks, index: Option<BlockIndex>| Some(form(blocks.get(index?)?));
    for edge in 0..graph.edges().len() {
        assert_eq!(of(kept, kept.of_edge(edge)), of(&anew, anew.of_edge(edge)));
    }
    for node in 0..graph.nodes().len() {
        assert_eq!(
            of(kept, kept.towards_first[node]),
            of(&anew, anew.towards_first[node])
        );
        let children = |blocks: &Blocks| {
            let indices = blocks.child_blocks(node).iter();
            let mut forms: Vec<Form> = indices.map(|&k| form(&blocks.blocks[k])).collect();
            forms.sort_unstable();
            forms
        };
        assert_eq!(children(kept), children(&anew));
    }
}

/// Something that happens to a graph.
#[derive(Debug, Clone)]
enum Step {
    Node,
    Edge(usize, usize, EdgeStatus),
    Status(usize, EdgeStatus),
}

fn any_status() -> impl Strategy<Value = EdgeStatus> {
    prop_oneof![
        6 => Just(EdgeStatus::Active),
        1 => Just(EdgeStatus::Retired),
        1 => Just(EdgeStatus::Quarantined),
    ]
}

fn any_step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => Just(Step::Node),
        5 => (0..30_usize, 0..30_usize, any_status()).prop_map(|(a, b, s)| Step::Edge(a, b, s)),
        1 => (0..40_usize, any_status()).prop_map(|(e, s)| Step::Status(e, s)),
    ]
}

fn apply(graph: &mut PoseGraph, step: &Step) {
    let (nodes, edges) = (graph.nodes().len(), graph.edges().len());
    match *step {
        Step::Node => {
            let id = NodeId(nodes as i64);
            let pose = Pose2::IDENTITY;
            graph.add_node(Node { id, pose }).unwrap();
        }
        Step::Edge(from, to, status) if nodes > 0 => {
            let edge = Edge {
                // Smaller and smaller ids, so that names change as blocks grow.
                id: EdgeId(1000 - edges as i64),
                from: NodeId((from % nodes) as i64),
                to: NodeId((to % nodes) as i64),
                measurement: Pose2::IDENTITY,
                information: Information::identity(),
                kind: EdgeKind::LoopClosure,
                status,
            };
            let _self_loops_are_refused = graph.add_edge(edge);
        }
        Step::Status(edge, status) if edges > 0 => {
            graph.set_edge_status(graph.edges()[edge % edges].id, status);
        }
        _ => {}
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn blocks_that_grew_are_those_found_anew(
        steps in prop::collection::vec(any_step(), 1..90),
    ) {
        let mut graph = PoseGraph::new();
        for step in &steps {
            graph.blocks();
            apply(&mut graph, step);
            check_like_new(&graph);
        }
    }
}

/// Rings that are closed one after the other, chains that are tied on late and backwards: sizes
/// that small random graphs do not have.
#[test]
fn long_ways_are_joined_and_turned_over() {
    let mut graph = graph(4000, &[]);
    graph.blocks();
    let mut next_id = 0;
    let mut tie = |graph: &mut PoseGraph, from: i64, to: i64| {
        next_id += 1;
        let edge = Edge {
            id: EdgeId(next_id),
            from: NodeId(from),
            to: NodeId(to),
            measurement: Pose2::IDENTITY,
            information: Information::identity(),
            kind: EdgeKind::Odometry,
            status: EdgeStatus::Active,
        };
        graph.add_edge(edge).unwrap();
    };
    for first in (0..4000).step_by(400) {
        for k in first + 1..first + 400 {
            tie(&mut graph, k - 1, k);
        }
        for ring in 0..9 {
            tie(&mut graph, first + 40 * ring + 35, first + 40 * ring);
        }
    }
    for first in (400..4000).step_by(400) {
        tie(&mut graph, first + 399, first - 330);
    }
    check_like_new(&graph);
    tie(&mut graph, 3610, 11);
    check_like_new(&graph);
}
