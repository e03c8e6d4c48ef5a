//! Given nodes and edges in a map: where they begin, what they add.

use std::f64::consts::FRAC_PI_2;

use proptest::prelude::*;

use super::super::given::GivenNode;
use super::*;
use crate::geometry::{Information, Pose2};
use crate::ids::{StampNs, TripId};
use crate::mapping::Weighting;
use crate::solver::{SolveOptions, solve};

fn node(k: usize) -> GivenNode {
    GivenNode {
        trip: TripId::new("t").unwrap(),
        stamp: StampNs(k as i64),
        pose: Pose2::new(50.0, k as f64, 1.0),
    }
}

fn edge(from: End, to: End, measurement: Pose2, kind: EdgeKind) -> GivenEdge {
    GivenEdge {
        from,
        to,
        measurement,
        information: Information::from_sigmas(0.05, 0.02),
        kind,
    }
}

/// A way round a square of `4 * side` nodes, each motion off by a little, and closures between
/// nodes that lie opposite.
fn ring(side: usize, off: &[f64]) -> GivenGraph {
    let count = 4 * side;
    let turn = |k: usize| {
        if k.is_multiple_of(side) {
            FRAC_PI_2
        } else {
            0.0
        }
    };
    let motion = |k: usize| Pose2::new(1.0, 0.0, turn(k));
    let mut truth = vec![node(0).pose];
    for k in 1..count {
        truth.push(truth[k - 1].compose(&motion(k)));
    }
    let off_by = |k: usize| {
        let next = |j: usize| off[(k + j) % off.len()];
        Pose2::new(next(0), next(1), 0.5 * next(2))
    };
    let odometry = (1..count).map(|k| {
        let (from, to) = (End::New(k - 1), End::New(k));
        edge(from, to, motion(k).compose(&off_by(k)), EdgeKind::Odometry)
    });
    let closures = (0..side).map(|k| {
        let (from, to) = (count - 1 - k, k);
        let measured = truth[from].between(&truth[to]).compose(&off_by(k + 3));
        edge(
            End::New(from),
            End::New(to),
            measured,
            EdgeKind::LoopClosure,
        )
    });
    GivenGraph {
        nodes: (0..count).map(node).collect(),
        edges: odometry.chain(closures).collect(),
    }
}

/// The same in parts: nodes in runs of `part`, each edge with the first part that has its ends.
fn in_parts(whole: &GivenGraph, part: usize) -> Vec<GivenGraph> {
    let last = |edge: &GivenEdge| {
        let place = |end| match end {
            End::New(place) => place,
            End::Known(_) => 0,
        };
        place(edge.from).max(place(edge.to))
    };
    let parts = whole.nodes.chunks(part).enumerate();
    let graph = |(p, nodes): (usize, &[GivenNode])| {
        let within = |edge: &&GivenEdge| last(edge) / part == p;
        let moved = |end: End| match end {
            End::New(place) if place >= p * part => End::New(place - p * part),
            // The map counts its nodes from 1.
            End::New(place) => End::Known(NodeId(place as i64 + 1)),
            known => known,
        };
        let edges = whole.edges.iter().filter(within).map(|edge| GivenEdge {
            from: moved(edge.from),
            to: moved(edge.to),
            ..*edge
        });
        GivenGraph {
            nodes: nodes.to_vec(),
            edges: edges.collect(),
        }
    };
    parts.map(graph).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn whole_or_in_parts_the_map_is_at_its_optimum(
        side in 2..8_usize,
        part in 3..12_usize,
        off in prop::collection::vec(-0.05..0.05_f64, 5..9),
    ) {
        let whole = ring(side, &off);
        let mut at_once = RouteMap::new(Weighting::Robust);
        let added = at_once.attach(&whole).unwrap();
        let growth: f64 = added.edges.iter().filter_map(|(_, delta_f)| *delta_f).sum();
        let cost = at_once.graph().cost();
        prop_assert!((growth - cost).abs() < 1e-6 * cost.max(1e-9), "{growth} {cost}");
        let mut solved = at_once.graph().clone();
        solve(&mut solved, &SolveOptions::default());
        let mut bit_by_bit = RouteMap::new(Weighting::Robust);
        for part in in_parts(&whole, part) {
            prop_assert!(bit_by_bit.untied(&part).is_empty());
            bit_by_bit.attach(&part).unwrap();
        }
        for map in [&at_once, &bit_by_bit] {
            let (cost, optimum) = (map.graph().cost(), solved.cost());
            prop_assert!((cost - optimum).abs() <= 1e-9 * optimum.max(1e-9), "{cost} {optimum}");
            for (a, b) in map.graph().nodes().iter().zip(solved.nodes()) {
                let apart = a.pose.between(&b.pose);
                prop_assert!(apart.translation().norm() < 1e-5 && apart.theta.abs() < 1e-5);
            }
        }
    }
}

#[test]
fn the_first_node_of_an_empty_map_is_where_it_says_and_others_are_where_edges_lead() {
    let mut map = RouteMap::new(Weighting::Robust);
    let step = Pose2::new(1.0, 0.0, 0.5);
    let graph = GivenGraph {
        nodes: (0..3).map(node).collect(),
        edges: vec![
            edge(End::New(2), End::New(1), step, EdgeKind::LoopClosure),
            edge(End::New(0), End::New(1), step, EdgeKind::Odometry),
        ],
    };
    let added = map.attach(&graph).unwrap();
    assert_eq!(added.nodes, [NodeId(1), NodeId(2), NodeId(3)]);
    assert_eq!(added.edges[0].1, Some(0.0), "nothing contradicts a bridge");
    assert_eq!(added.edges[1].1, None);
    let first = node(0).pose;
    let second = first.compose(&step);
    let third = second.compose(&step.inverse());
    for (node, expected) in map.graph().nodes().iter().zip([first, second, third]) {
        let apart = node.pose.between(&expected);
        assert!(apart.translation().norm() < 1e-12 && apart.theta.abs() < 1e-12);
    }
    assert!(map.keyframes().iter().all(|k| k.scan.is_none()));
    let references: Vec<bool> = map.keyframes().iter().map(|k| k.reference).collect();
    assert_eq!(
        references,
        [true, true, false],
        "the third stands where the first does"
    );
}

#[test]
fn what_hangs_on_nothing_is_told() {
    let mut map = RouteMap::new(Weighting::Robust);
    let step = Pose2::new(1.0, 0.0, 0.0);
    let pair = |k| edge(End::New(k), End::New(k + 1), step, EdgeKind::Odometry);
    let graph = GivenGraph {
        nodes: (0..4).map(node).collect(),
        edges: vec![pair(0), pair(2)],
    };
    assert_eq!(map.untied(&graph), [2, 3]);
    map.attach(&ring(2, &[0.0])).unwrap();
    assert_eq!(map.untied(&graph), [0, 1, 2, 3]);
    let tie = edge(
        End::Known(NodeId(3)),
        End::New(3),
        step,
        EdgeKind::LoopClosure,
    );
    let tied = GivenGraph {
        edges: vec![pair(0), pair(2), tie],
        ..graph
    };
    assert_eq!(map.untied(&tied), [0, 1]);
}

#[test]
fn odometry_that_closes_a_ring_is_solved_too() {
    let mut graph = ring(3, &[0.03, -0.02]);
    for edge in &mut graph.edges {
        edge.kind = EdgeKind::Odometry;
    }
    let mut map = RouteMap::new(Weighting::Robust);
    map.attach(&graph).unwrap();
    let mut solved = map.graph().clone();
    solve(&mut solved, &SolveOptions::default());
    assert!((map.graph().cost() - solved.cost()).abs() < 1e-9);
}

#[test]
fn the_paper_s_graph_has_the_identity_as_information() {
    let mut map = RouteMap::new(Weighting::AllPointsIdentity);
    map.attach(&ring(2, &[0.01])).unwrap();
    let edges = map.graph().edges();
    assert!(
        edges
            .iter()
            .all(|e| e.information == Information::identity())
    );
}

/// A drive with so many closures between nodes at random.
fn tangle(nodes: usize, closures: usize) -> GivenGraph {
    let mut given = ring(nodes / 4, &[0.0]);
    given.edges.truncate(nodes - 1);
    let mut state = 1_u64;
    let mut random = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 33) as usize % nodes
    };
    for _ in 0..closures {
        let (from, to) = (random(), random());
        if from != to {
            let (a, b) = (given.nodes[from].pose, given.nodes[to].pose);
            let closure = edge(
                End::New(from),
                End::New(to),
                a.between(&b),
                EdgeKind::LoopClosure,
            );
            given.edges.push(closure);
        }
    }
    given
}

#[test]
fn what_could_not_be_solved_in_time_is_refused_before_it_is_tried() {
    let mut map = RouteMap::new(Weighting::Robust);
    let refused = map.attach(&tangle(3_000, 17_000));
    assert!(
        matches!(refused, Err(NotAttached::TooDense { .. })),
        "{refused:?}"
    );
    let mut map = RouteMap::new(Weighting::Robust);
    assert!(map.attach(&tangle(120, 300)).is_ok());
}

#[test]
fn a_batch_takes_no_more_multiplications_than_it_may() {
    let given = ring(40, &[0.03, -0.02, 0.01]);
    let mut map = RouteMap::new(Weighting::Robust);
    let refused = map.attach_within(&given, 1e5);
    assert!(
        matches!(refused, Err(NotAttached::TooCostly)),
        "{refused:?}"
    );
    let taken = map.solver.operations();
    // The step that exceeds it is the last one.
    assert!((1e5..1e6).contains(&taken), "{taken}");
    let mut map = RouteMap::new(Weighting::Robust);
    map.attach_within(&given, 1e9).unwrap();
}

#[test]
fn nothing_is_solved_to_its_end_for_nobody() {
    let mut map = RouteMap::new(Weighting::Robust);
    let interrupt = crate::solver::Interrupt::default();
    interrupt.raise();
    map.heed(&interrupt);
    let attached = map.attach(&ring(8, &[0.01, -0.02, 0.03]));
    assert!(
        matches!(attached, Err(NotAttached::Interrupted)),
        "{attached:?}"
    );
}
