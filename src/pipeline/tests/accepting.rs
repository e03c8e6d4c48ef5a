use super::bench::{BOX_AT, Bench, MapState, box_finding, route, sha256};
use crate::change::{AlertAction, AlertStatus};
use crate::graph::EdgeStatus;
use crate::model::VersionAction;
use crate::render::Occupancy;
use crate::store::{AlertRecord, MapPicture};

fn without_residuals(state: &MapState) -> Vec<(i64, EdgeStatus)> {
    let edges = state.edges.iter();
    edges.map(|edge| (edge.id.0, edge.status)).collect()
}

fn references(state: &MapState) -> Vec<i64> {
    let references = state.nodes.iter().filter(|node| node.reference);
    references.map(|node| node.id.0).collect()
}

/// The state of the cell that the box's near side lies in, read from the PGM.
fn at_the_box(picture: &MapPicture) -> Occupancy {
    let field = |name: &str| -> Vec<f64> {
        let line = picture.yaml.lines().find(|l| l.starts_with(name)).unwrap();
        let numbers = line.split([' ', '[', ']', ',']);
        numbers.filter_map(|n| n.parse().ok()).collect()
    };
    let (origin, resolution_m) = (field("origin"), field("resolution")[0]);
    let mut header = picture.pgm.split(|b| *b == b'\n').skip(1);
    let size = String::from_utf8(header.next().unwrap().to_vec()).unwrap();
    let size: Vec<usize> = size.split(' ').map(|n| n.parse().unwrap()).collect();
    let pixels = &picture.pgm[picture.pgm.len() - size[0] * size[1]..];
    let column = ((BOX_AT.x - origin[0]) / resolution_m) as usize;
    let row = ((BOX_AT.y + 0.2 - origin[1]) / resolution_m) as usize;
    // The pose of the map is known to a few centimetres: the darkest of the cells around.
    let around = (row - 1..=row + 1).map(|row| pixels[(size[1] - 1 - row) * size[0] + column]);
    match around.min().unwrap() {
        0 => Occupancy::Occupied,
        254 => Occupancy::Free,
        _ => Occupancy::Unknown,
    }
}

async fn versions(bench: &Bench) -> Vec<crate::store::MapVersionRecord> {
    let store = &bench.engine.store;
    store.map_versions(&route(), 0, 10).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn accepting_retires_hands_over_solves_and_begins_a_version() {
    let (bench, alert) = Bench::with_alert().await;
    let before = bench.state().await;
    let picture_before = bench.picture().await;
    assert!(!alert.evidence.edges.is_empty() && alert.evidence.nodes.len() > 4);
    let accepted = bench.decide(&alert, AlertAction::Accept).await;

    assert_eq!(accepted.status, AlertStatus::Accepted);
    assert_eq!(accepted.revision, alert.revision + 1);
    let last = accepted.history.last().unwrap();
    assert_eq!(
        (last.status, last.by.as_str()),
        (AlertStatus::Accepted, "keeper")
    );
    let stored = bench.engine.store.alert(alert.id).await.unwrap();
    assert_eq!(stored.as_ref(), Some(&accepted));

    let after = bench.state().await;
    for (old, new) in before.edges.iter().zip(&after.edges) {
        let is_retired = alert.evidence.edges.contains(&new.id);
        assert_eq!(new.status == EdgeStatus::Retired, is_retired, "{}", new.id);
        assert_eq!((old.id, old.measurement), (new.id, new.measurement));
        assert!(!is_retired || new.subgraph_id.is_none());
    }
    let since = alert.evidence.since;
    let of_alert = |id: i64| alert.evidence.nodes.iter().any(|node| node.0 == id);
    for node in &after.nodes {
        assert!(!(node.reference && of_alert(node.id.0) && node.stamp < since));
    }
    let new = references(&after).into_iter().filter(|id| of_alert(*id));
    assert!(new.count() >= 2);
    // What is left is at its optimum: retired edges pull no more.
    let active = |state: &MapState| -> f64 {
        let edges = state
            .edges
            .iter()
            .filter(|e| e.status == EdgeStatus::Active);
        edges.map(|edge| edge.residual).sum()
    };
    assert!(active(&after) < active(&before));

    let record = bench.engine.store.route(&route()).await.unwrap().unwrap();
    assert_eq!((record.map_version, record.epoch), (2, 2));
    assert_eq!(record.counts.open_alerts, 0);
    let versions = versions(&bench).await;
    assert_eq!(versions.len(), 2);
    assert_eq!(versions[0].sha256, Some(sha256(&before.pgm)));
    assert_eq!((&versions[0].cause, versions[1].sha256), (&None, None));
    let cause = versions[1].cause.as_ref().unwrap();
    assert!(versions[1].max_displacement_m.unwrap() >= 0.0);
    assert_eq!(
        (cause.alert_id, cause.action),
        (Some(alert.id), VersionAction::Accept)
    );
    let filed = bench
        .engine
        .store
        .map_version_picture(&route(), 1)
        .await
        .unwrap();
    assert_eq!(filed.unwrap(), picture_before);
}

/// Two laps saw the floor and one saw the box: only once that is accepted does the map show it
/// without the floor's looks, however many more there were.
#[tokio::test(flavor = "multi_thread")]
async fn the_picture_shows_the_new_state() {
    let bench = Bench::new().await;
    bench.lap("before", 0, 6, |_| Vec::new()).await;
    bench.lap("after", 1, 1, |map| vec![box_finding(map)]).await;
    let alert = bench.alerts().await.remove(0);
    assert_eq!(at_the_box(&bench.picture().await), Occupancy::Free);
    let accepted = bench.decide(&alert, AlertAction::Accept).await;
    assert_eq!(at_the_box(&bench.picture().await), Occupancy::Occupied);
    bench.decide(&accepted, AlertAction::Undo).await;
    assert_eq!(at_the_box(&bench.picture().await), Occupancy::Free);
}

async fn undone_is_as_before(restart: bool, acknowledged: bool) {
    let (mut bench, mut alert) = Bench::with_alert().await;
    if acknowledged {
        alert = bench.decide(&alert, AlertAction::Acknowledge).await;
    }
    let before = bench.state().await;
    let accepted = bench.decide(&alert, AlertAction::Accept).await;
    assert!(bench.state().await != before);
    if restart {
        bench = bench.restarted().await;
        assert_eq!(bench.alerts().await, std::slice::from_ref(&accepted));
    }
    let undone = bench.decide(&accepted, AlertAction::Undo).await;
    assert_eq!(undone.status, alert.status);
    assert_eq!(undone.history.len(), alert.history.len() + 2);
    assert!(bench.state().await == before);

    let versions = versions(&bench).await;
    let numbers: Vec<i64> = versions.iter().map(|version| version.version).collect();
    assert_eq!(numbers, [1, 2, 3]);
    assert_eq!(versions[0].sha256, Some(sha256(&bench.picture().await.pgm)));
    assert_ne!(versions[1].sha256, versions[0].sha256);
    assert_eq!(
        versions[2].cause.as_ref().unwrap().action,
        VersionAction::Undo
    );
    let store = &bench.engine.store;
    assert!(store.accepted_changes(&route()).await.unwrap().is_empty());
    assert!(store.acceptance(alert.id).await.unwrap().is_none());
    // It can be accepted again, and so can its undo be undone.
    let again = bench.decide(&undone, AlertAction::Accept).await;
    bench.decide(&again, AlertAction::Undo).await;
    assert!(bench.state().await == before);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_undo_restores_the_map_to_the_bit() {
    undone_is_as_before(false, false).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_undo_after_a_restart_restores_the_map_to_the_bit() {
    undone_is_as_before(true, true).await;
}

/// After another batch the poses are solved for, not restored; edges and references are.
#[tokio::test(flavor = "multi_thread")]
async fn an_undo_after_another_batch_restores_edges_and_references() {
    let (bench, alert) = Bench::with_alert().await;
    let before = bench.state().await;
    let accepted: AlertRecord = bench.decide(&alert, AlertAction::Accept).await;
    bench.lap("later", 2, 1, |_| Vec::new()).await;
    bench.decide(&accepted, AlertAction::Undo).await;
    let after = bench.state().await;
    assert!(after.nodes.len() > before.nodes.len());
    let known = before.edges.len();
    assert_eq!(
        without_residuals(&after)[..known],
        without_residuals(&before)
    );
    let known = i64::try_from(before.nodes.len()).unwrap();
    let restored = references(&after).into_iter().filter(|id| *id <= known);
    assert_eq!(restored.collect::<Vec<_>>(), references(&before));
    for (old, new) in before.nodes.iter().zip(&after.nodes) {
        let moved_m = (old.pose.translation() - new.pose.translation()).norm();
        assert!(moved_m < 0.02, "{moved_m}");
    }
}

/// Later closures are tied to the nodes that show the new state.
#[tokio::test(flavor = "multi_thread")]
async fn later_laps_are_tied_to_the_new_state() {
    let (bench, alert) = Bench::with_alert().await;
    bench.decide(&alert, AlertAction::Accept).await;
    let known = bench.state().await.edges.len();
    bench.lap("later", 2, 1, |_| Vec::new()).await;
    let state = bench.state().await;
    let ends: Vec<_> = state.edges[known..].iter().map(|edge| edge.from).collect();
    let stamp = |id| state.nodes.iter().find(|n| n.id == id).unwrap().stamp;
    let since = alert.evidence.since;
    let tied = alert.evidence.nodes.iter().filter(|n| ends.contains(n));
    let new = tied.clone().filter(|n| stamp(**n) >= since).count();
    let old = tied.count() - new;
    assert!(new > 0 && old == 0, "{new} {old}");
}
