//! Reads of a part of a map, compared with all of its nodes and edges.

use std::collections::BTreeMap;

use mapshift::geometry::Vector2;
use mapshift::graph::{EdgeKind, EdgeStatus};
use mapshift::ids::{EdgeId, NodeId, StampNs, TripId, VehicleId};
use mapshift::model::BatchStatus;
use mapshift::store::{Applied, EdgeChange, NodeRecord, Store, TimesOfChange, UploadLag, Within};

use crate::settled::settled;
use crate::support::{Fixture, at, intermediate, route, upload};

/// A rectangle with about half of the nodes of `settled`.
const HALF: Within = Within {
    x: [1.0, 3.4],
    y: [-1.0, 1.0],
};

#[tokio::test]
async fn nodes_about_a_change_lie_in_the_rectangle_active_or_not_on_both_sides_of_it() {
    let fixture = settled().await;
    let all = fixture.store.nodes(&route()).await.unwrap();
    let inside = |node: &NodeRecord| HALF.x[0] <= node.pose.x && node.pose.x <= HALF.x[1];
    let mut inside: Vec<NodeRecord> = all.into_iter().filter(inside).collect();
    inside.retain(NodeRecord::is_localised);
    inside.sort_by_key(|node| (node.stamp, node.id));
    assert!(inside.iter().any(|node| node.active) && inside.iter().any(|node| !node.active));
    let times = TimesOfChange {
        from: StampNs(i64::MIN),
        since: inside[inside.len() / 2].stamp,
        until: None,
    };
    let (before, since): (Vec<NodeRecord>, Vec<NodeRecord>) = inside
        .into_iter()
        .partition(|node| node.stamp < times.since);
    let ids = |nodes: &[NodeRecord]| nodes.iter().map(|node| node.id).collect::<Vec<NodeId>>();
    for side_max in [2, 1_000] {
        let kept = side_max.min(before.len());
        let half = (side_max / 2).min(since.len());
        let mut expected = ids(&before[before.len() - kept..]);
        expected.extend(ids(&since[..half]));
        expected.extend(ids(&since[since.len() - half..]));
        expected.sort_unstable();
        expected.dedup();
        let found = fixture
            .store
            .nodes_about_change(&route(), HALF, times, side_max as u32)
            .await;
        assert_eq!(found.unwrap(), expected, "{side_max}");
    }
}

#[tokio::test]
async fn scans_of_some_nodes_are_those_of_the_whole_route() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b0", "t", 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.chain(&job, 4).await;
    result.intermediate = (0..5).map(|place| intermediate(2, place)).collect();
    fixture.store.apply_result(result).await.unwrap();
    let all = fixture.store.nodes_with_scans(&route()).await.unwrap();
    for behind_max in [0, 3, 9] {
        let ids = [4, 2, 77].map(NodeId);
        let found = fixture
            .store
            .scans_of_nodes(&route(), &ids, behind_max)
            .await;
        let mut expected = vec![all[1].clone(), all[3].clone()];
        for node in &mut expected {
            node.intermediate.truncate(behind_max as usize);
        }
        assert_eq!(found.unwrap(), expected);
    }
}

#[tokio::test]
async fn references_are_the_active_ones_by_id() {
    let fixture = settled().await;
    let all = fixture.store.nodes(&route()).await.unwrap();
    let references = all.iter().filter(|node| node.active && node.reference);
    let expected: Vec<Vector2<f64>> = references
        .map(|node| Vector2::new(node.pose.x, node.pose.y))
        .collect();
    assert!(!expected.is_empty() && expected.len() < all.len());
    let found = fixture.store.reference_positions(&route()).await.unwrap();
    assert_eq!(found, expected);
}

/// The closures between active nodes that are not retired, by their residuals.
async fn by_residual(store: &Store) -> Vec<(EdgeId, f64)> {
    let graph = store.load_graph(&route()).await.unwrap().unwrap();
    let closures = graph.edges.iter();
    let closures = closures
        .filter(|edge| edge.kind == EdgeKind::LoopClosure && edge.status == EdgeStatus::Active);
    let mut closures: Vec<_> = closures.map(|edge| (edge.id, edge.residual)).collect();
    closures.sort_by(|a, b| b.1.total_cmp(&a.1));
    closures
}

#[tokio::test]
async fn the_worst_closures_come_first_and_none_that_is_retired() {
    let fixture = settled().await;
    let store = &fixture.store;
    let worst = async |limit| {
        let worst = store.worst_closures(&route(), limit).await.unwrap();
        let worst = worst
            .iter()
            .map(|closure| (closure.edge_id, closure.residual));
        worst.collect::<Vec<_>>()
    };
    let before = by_residual(store).await;
    assert_eq!(before.len(), 2);
    assert_eq!(worst(10).await, before);
    assert_eq!(worst(1).await, before[..1]);

    fixture.journal(upload("b2", "new", 1)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.result(&job, BatchStatus::Merged).await;
    result.changed_edges = [101, 103].map(retired).to_vec();
    assert_eq!(
        store.apply_result(result).await.unwrap(),
        Applied::Committed
    );
    assert_eq!(worst(10).await, by_residual(store).await);
    let asked = [1, 101, 102, 103, 104, 999].map(EdgeId);
    let active = store.active_closures_among(&route(), &asked).await;
    assert_eq!(active.unwrap(), [102, 104].map(EdgeId));
}

fn retired(id: i64) -> EdgeChange {
    EdgeChange {
        id: EdgeId(id),
        status: EdgeStatus::Retired,
        subgraph_id: None,
    }
}

#[tokio::test]
async fn tracks_are_the_nodes_of_the_newest_trips_in_their_order() {
    let fixture = settled().await;
    let store = &fixture.store;
    let mut by_trip: BTreeMap<TripId, Vec<NodeRecord>> = BTreeMap::new();
    for node in store.nodes(&route()).await.unwrap() {
        by_trip.entry(node.trip_id.clone()).or_default().push(node);
    }
    let newest = |nodes: &Vec<NodeRecord>| nodes.iter().map(|node| node.stamp).max();
    let mut trips: Vec<_> = by_trip.into_iter().collect();
    trips.sort_by_key(|(_, nodes)| std::cmp::Reverse(newest(nodes)));
    for limit in 0..=3 {
        let tracks = store.newest_tracks(&route(), limit).await.unwrap();
        let found = tracks.into_iter().map(|track| (track.trip_id, track.poses));
        let expected = trips.iter().take(limit).map(|(trip, nodes)| {
            let poses = nodes.iter().map(|node| (node.stamp, node.pose));
            (trip.clone(), poses.collect::<Vec<_>>())
        });
        assert_eq!(found.collect::<Vec<_>>(), expected.collect::<Vec<_>>());
    }
}

/// The lags are those of the vehicle's trip before the given one.
#[tokio::test]
async fn lags_are_of_the_trip_before_and_of_what_is_in_the_map() {
    let fixture = Fixture::new().await;
    let (store, vehicle) = (&fixture.store, &VehicleId::new("v").unwrap());
    let trip = |name: &str| TripId::new(name).unwrap();
    for (id, name, sequence, received) in
        [("a0", "a", 0, 10), ("a1", "a", 1, 20), ("b0", "b", 0, 30)]
    {
        let mut batch = upload(id, name, sequence);
        batch.received_at = at(received);
        fixture.journal(batch).await;
        let job = fixture.claim(40).await.unwrap();
        let chain = fixture.chain(&job, 2).await;
        store.apply_result(chain).await.unwrap();
    }
    fixture.journal(upload("a2", "a", 2)).await;
    let lag = |node: i64, received| UploadLag {
        newest: StampNs(1_000 * node),
        received_at: at(received),
    };
    let lags = |of: TripId| async move {
        let lags = store.upload_lags(&route(), vehicle, &of).await;
        lags.unwrap()
    };
    assert_eq!(lags(trip("b")).await, [lag(4, 20), lag(2, 10)]);
    assert_eq!(lags(trip("new")).await, [lag(6, 30)]);
    assert_eq!(lags(trip("a")).await, [lag(6, 30)]);
    let stranger = VehicleId::new("w").unwrap();
    let none = store.upload_lags(&route(), &stranger, &trip("a")).await;
    assert_eq!(none.unwrap(), []);
}

/// The lags of a trip, and of the newest trip of each vehicle but one.
#[tokio::test]
async fn lags_of_others_are_those_of_their_newest_trips() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let vehicle = |name: &str| VehicleId::new(name).unwrap();
    let trip = |name: &str| TripId::new(name).unwrap();
    for (id, name, of, received) in [
        ("a0", "a", "v", 10),
        ("w0", "w1", "w", 20),
        ("w1", "w2", "w", 30),
    ] {
        let mut batch = upload(id, name, 0);
        (batch.vehicle_id, batch.received_at) = (vehicle(of), at(received));
        fixture.journal(batch).await;
        let job = fixture.claim(40).await.unwrap();
        let chain = fixture.chain(&job, 2).await;
        store.apply_result(chain).await.unwrap();
    }
    let lag = |node: i64, received| UploadLag {
        newest: StampNs(1_000 * node),
        received_at: at(received),
    };
    for (name, expected) in [
        ("a", vec![lag(2, 10)]),
        ("w2", vec![lag(6, 30)]),
        ("x", vec![]),
    ] {
        let lags = store.trip_lags(&route(), &trip(name)).await;
        assert_eq!(lags.unwrap(), expected, "{name}");
    }
    for (of, name, expected) in [("v", "a", lag(6, 30)), ("w", "w2", lag(2, 10))] {
        let (vehicle, trip) = (vehicle(of), trip(name));
        let lags = store.lags_of_others(&route(), &vehicle, &trip).await;
        assert_eq!(lags.unwrap(), [[expected]], "{of}");
    }
}

#[tokio::test]
async fn trips_are_listed_by_name_in_parts_with_what_their_batches_say() {
    let fixture = settled().await;
    let store = &fixture.store;
    fixture.journal(upload("late", "new", 5)).await;
    fixture.journal(upload("empty", "another", 3)).await;
    let whole = store.trip_page(&route(), None, 10).await.unwrap();
    let said: Vec<_> = whole
        .iter()
        .map(|trip| {
            (
                trip.id.as_str(),
                trip.batches,
                trip.merged,
                trip.scans,
                trip.stamps,
            )
        })
        .collect();
    let stamps = |first: i64, last: i64| Some((StampNs(1_000 * first), StampNs(1_000 * last)));
    assert_eq!(
        said,
        [
            ("another", 1, 0, 3, None),
            ("new", 2, 1, 6, stamps(11, 15)),
            ("old", 1, 1, 3, stamps(1, 10)),
        ]
    );
    let mut parts: Vec<TripId> = Vec::new();
    loop {
        let mut part = store.trip_page(&route(), parts.last(), 1).await.unwrap();
        match part.pop() {
            Some(trip) => parts.push(trip.id),
            None => break,
        }
    }
    assert_eq!(
        parts,
        whole.into_iter().map(|trip| trip.id).collect::<Vec<_>>()
    );
}
