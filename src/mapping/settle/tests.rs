use proptest::prelude::*;

use super::super::route_map::Weighting;
use super::super::testing::blind_keyframe;
use super::*;
use crate::geometry::{Information, Pose2};
use crate::graph::{Edge, EdgeKind};
use crate::ids::EdgeId;
use crate::solver::{SolveOptions, solve};

const MINUTE_NS: i64 = 60_000_000_000;

fn trip(number: i64) -> TripId {
    TripId::new(format!("t{number}")).unwrap()
}

fn keyframe(id: i64, of_trip: i64, stamp_ns: i64) -> Keyframe {
    blind_keyframe(id, trip(of_trip), StampNs(stamp_ns))
}

fn edge(id: i64, from: i64, to: i64, kind: EdgeKind) -> Edge {
    Edge {
        id: EdgeId(id),
        from: NodeId(from),
        to: NodeId(to),
        measurement: Pose2::new(1.0, 0.01 * (id % 7) as f64, 0.0),
        information: Information::identity(),
        kind,
        status: EdgeStatus::Active,
    }
}

fn restored(nodes: Vec<(Pose2, Keyframe)>, edges: Vec<Edge>) -> RouteMap {
    let next = (
        NodeId(nodes.len() as i64 + 1),
        EdgeId(edges.len() as i64 + 1),
    );
    RouteMap::restore(Weighting::Robust, nodes, edges, next.0, next.1).unwrap()
}

const TRIP_NODES: i64 = 6;

/// Trips of six nodes, one every minute, that arrive in an order; the nodes of the first trip are
/// references, and every node of the others is tied to its like among them.
fn laps(order: &[i64]) -> RouteMap {
    let (mut nodes, mut edges) = (Vec::new(), Vec::new());
    for &number in order {
        for k in 0..TRIP_NODES {
            let id = nodes.len() as i64 + 1;
            let stamp_ns = number * MINUTE_NS + k;
            let mut keyframe = keyframe(id, number, stamp_ns);
            keyframe.reference = number == order[0];
            nodes.push((Pose2::new(k as f64, 0.0, 0.0), keyframe));
            if k > 0 {
                let next = edges.len() as i64 + 1;
                edges.push(edge(next, id - 1, id, EdgeKind::Odometry));
            }
            if number != order[0] {
                let next = edges.len() as i64 + 1;
                edges.push(edge(next, k + 1, id, EdgeKind::LoopClosure));
            }
        }
    }
    restored(nodes, edges)
}

/// Trips and places in them of the nodes that can leave, in their order.
fn leaving(map: &RouteMap, stretches: usize, going_on: i64, named: &[i64]) -> Vec<(String, u32)> {
    leaving_but_first(map, stretches, 0, going_on, named)
}

fn leaving_but_first(
    map: &RouteMap,
    stretches: usize,
    first_stretches: usize,
    going_on: i64,
    named: &[i64],
) -> Vec<(String, u32)> {
    let named = named.iter().map(|&id| NodeId(id)).collect();
    let ids = map.settled_nodes(&Stay {
        stretches,
        trip: &trip(going_on),
        nodes: &named,
        first_stretches,
    });
    assert!(ids.is_sorted());
    let place = |id: &NodeId| {
        let keyframe = &map.keyframes[map.graph.node_position(*id).unwrap()];
        (keyframe.trip.to_string(), keyframe.trip_order)
    };
    let mut places: Vec<_> = ids.iter().map(place).collect();
    places.sort();
    places
}

fn whole_trips(numbers: &[i64]) -> Vec<(String, u32)> {
    let nodes = |number: i64| (0..TRIP_NODES as u32).map(move |k| (format!("t{number}"), k));
    numbers.iter().copied().flat_map(nodes).collect()
}

const NOBODY: i64 = 99;

#[test]
fn what_leaves_rests_on_stamps_not_on_the_order_of_arrival() {
    for order in [[0, 1, 2, 3, 4, 5], [0, 5, 3, 1, 4, 2], [0, 4, 5, 2, 3, 1]] {
        let map = laps(&order);
        // Three begin after the last scan of each of the trips 1 and 2; trip 0 is the reference.
        assert_eq!(leaving(&map, 3, NOBODY, &[]), whole_trips(&[1, 2]));
        assert_eq!(leaving(&map, 5, NOBODY, &[]), []);
        assert_eq!(leaving(&map, 0, NOBODY, &[]), []);
    }
}

#[test]
fn what_is_going_on_or_named_stays() {
    let map = laps(&[0, 1, 2, 3, 4, 5]);
    assert_eq!(leaving(&map, 3, 1, &[]), whole_trips(&[2]));
    let mut expected = whole_trips(&[1, 2]);
    expected.retain(|(trip, k)| trip != "t2" || *k != 1);
    // Node 14 is the second of trip 2.
    assert_eq!(leaving(&map, 3, NOBODY, &[14]), expected);
}

#[test]
fn of_every_place_the_first_drives_stay() {
    for order in [[0, 1, 2, 3, 4, 5, 6, 7], [0, 6, 4, 2, 7, 5, 3, 1]] {
        let mut map = laps(&order);
        let leaving = |map: &RouteMap, first| leaving_but_first(map, 3, first, NOBODY, &[]);
        assert_eq!(leaving(&map, 1), whole_trips(&[1, 2, 3, 4]));
        assert_eq!(leaving(&map, 3), whole_trips(&[3, 4]));
        // The fourth trip turns off where nobody was before.
        let turned_off: Vec<usize> = map.trips[&trip(3)][2..].to_vec();
        for &k in &turned_off {
            let node = map.graph.nodes()[k];
            let aside = Pose2::new(node.pose.x, 20.0, 0.0);
            map.graph.set_pose(node.id, aside);
        }
        let mut expected = whole_trips(&[3, 4]);
        expected.retain(|(trip, k)| trip != "t3" || *k < 2);
        assert_eq!(leaving(&map, 3), expected);
    }
}

#[test]
fn too_few_stay_for_company() {
    let mut map = laps(&[0, 1, 2, 3, 4, 5]);
    for id in 7..=17 {
        map.set_reference(NodeId(id), true);
    }
    // Of 36 nodes one alone could leave.
    assert_eq!(leaving(&map, 3, NOBODY, &[]), []);
    map.set_reference(NodeId(15), false);
    map.set_reference(NodeId(16), false);
    assert_eq!(leaving(&map, 3, NOBODY, &[]).len(), 3);
}

#[test]
fn of_a_long_trip_the_oldest_part_leaves() {
    // One trip that looks every minute for three hours: stretches of ten nodes.
    let node = |k: i64| {
        let mut keyframe = keyframe(k + 1, 0, k * MINUTE_NS);
        keyframe.reference = k == 0;
        (Pose2::new(k as f64, 0.0, 0.0), keyframe)
    };
    let chain = (1..180).map(|k| edge(k, k, k + 1, EdgeKind::Odometry));
    let ties = (3..=180).map(|k| edge(177 + k, 1, k, EdgeKind::LoopClosure));
    let map = restored((0..180).map(node).collect(), chain.chain(ties).collect());
    let gone = leaving(&map, 4, 0, &[]);
    assert_eq!(gone.first(), Some(&("t0".to_owned(), 1)));
    // The fourth of the newest stretches and the first node stay, the last stretch is not full.
    assert!(
        (180 - 40 - 1..180 - 30 - 1).contains(&gone.len()),
        "{}",
        gone.len()
    );
    assert_eq!(gone.last(), Some(&("t0".to_owned(), gone.len() as u32)));
    assert_eq!(leaving(&map, 2, 0, &[]).len(), 180 - TRIP_TAIL - 1);
}

#[test]
fn the_stretches_of_a_fleet_begin_one_after_the_other() {
    let mut phases: Vec<i64> = (0..20).map(|k| phase_ns(&trip(k))).collect();
    phases.sort_unstable();
    assert!(phases.iter().all(|phase| (0..STRETCH_NS).contains(phase)));
    let at_once = |from: &i64| {
        let soon = |phase: &&i64| (*from..*from + MINUTE_NS).contains(*phase);
        phases.iter().filter(soon).count()
    };
    assert!(
        phases.iter().all(|from| at_once(from) < ACTIVE_STRETCHES),
        "{phases:?}"
    );
}

#[test]
fn what_is_left_is_whole_and_at_its_optimum() {
    let mut map = laps(&[0, 1, 2, 3, 4, 5]);
    let everything: Vec<_> = map.graph.edges().iter().map(|e| (e.id, e.status)).collect();
    map.restate_edges(&everything);
    let (nodes, edges) = (map.graph.nodes().len(), map.graph.edges().len());
    let gone = map.settled_nodes(&Stay {
        stretches: 3,
        trip: &trip(NOBODY),
        nodes: &BTreeSet::new(),
        first_stretches: 0,
    });
    let orders: Vec<_> = map
        .keyframes
        .iter()
        .map(|k| (k.node, k.trip_order))
        .collect();
    let size_bytes = map.size_bytes();
    map.release(&gone).unwrap();

    assert_eq!(map.graph.nodes().len(), nodes - 12);
    assert_eq!(map.graph.edges().len(), edges - 2 * 11);
    assert!(map.size_bytes() < size_bytes);
    let kept = map.graph.nodes().iter().map(|node| node.id);
    assert!(kept.eq(map.keyframes.iter().map(|keyframe| keyframe.node)));
    for keyframe in &map.keyframes {
        assert!(orders.contains(&(keyframe.node, keyframe.trip_order)));
    }
    assert!(!map.trips.contains_key(&trip(1)) && map.trips.contains_key(&trip(5)));
    assert_eq!(map.next_node_id(), NodeId(37));
    assert_eq!(map.next_edge_id(), EdgeId(edges as i64 + 1));
    let mut whole = map.graph.clone();
    solve(&mut whole, &SolveOptions::default());
    assert!((whole.cost() - map.graph.cost()).abs() < 1e-9 * (1.0 + whole.cost()));
    // A part of it that stands alone is the same map.
    let nodes = map.graph.nodes().iter().zip(&map.keyframes);
    let nodes = nodes.map(|(node, keyframe)| (node.pose, keyframe.clone()));
    let again = restored(nodes.collect(), map.graph.edges().to_vec());
    let places = |map: &RouteMap| map.trips.clone();
    assert_eq!(places(&again), places(&map));
    assert!(
        again
            .keyframes
            .iter()
            .zip(&map.keyframes)
            .all(|(a, b)| a.trip_order == b.trip_order)
    );
}

/// The first node of each node's component among the nodes that `there` has.
fn components(graph: &PoseGraph, there: &[bool]) -> Vec<usize> {
    let mut first: Vec<usize> = (0..there.len()).collect();
    for _ in 0..there.len() {
        for &(a, b) in graph.ends() {
            if there[a] && there[b] {
                let lowest = first[a].min(first[b]);
                first[a] = lowest;
                first[b] = lowest;
            }
        }
    }
    first
}

proptest! {
    /// Whatever wants to leave, the others hang together as they did.
    #[test]
    fn what_stays_does_not_fall_apart(
        ties in prop::collection::vec((0_i64..24, 0_i64..24), 0..40),
        wanted in prop::collection::vec(any::<bool>(), 24),
    ) {
        let nodes = (0..24).map(|k| (Pose2::IDENTITY, keyframe(k + 1, 0, k)));
        let ties: Vec<_> = ties.into_iter().filter(|(a, b)| a != b).collect();
        let edges = ties.iter().zip(1..);
        let edges = edges.map(|(&(a, b), id)| edge(id, a + 1, b + 1, EdgeKind::LoopClosure));
        let map = restored(nodes.collect(), edges.collect());
        let mut leaving = wanted.clone();
        keep_what_ties(&map.graph, &mut leaving);
        let stays: Vec<bool> = leaving.iter().map(|leaves| !leaves).collect();
        prop_assert!((0..24).all(|k| wanted[k] || stays[k]));
        let before = components(&map.graph, &[true; 24]);
        let after = components(&map.graph, &stays);
        for a in 0..24 {
            for b in 0..a {
                if !wanted[a] && !wanted[b] && before[a] == before[b] {
                    prop_assert_eq!(after[a], after[b]);
                }
            }
        }
        // Nobody is kept in a component in which nothing stays anyway.
        for k in (0..24).filter(|&k| wanted[k] && stays[k]) {
            prop_assert!((0..24).any(|j| !wanted[j] && before[j] == before[k]));
        }
    }
}
