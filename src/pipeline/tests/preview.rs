use super::bench::{Bench, MapState, box_finding};
use crate::change::AlertAction;
use crate::graph::EdgeStatus;
use crate::pipeline::DecisionError;
use crate::render::DifferingCells;

const OCCUPIED: u8 = 0;
const UNKNOWN: u8 = 205;
const FREE: u8 = 254;

/// The pixels of a PGM.
fn pixels(pgm: &[u8]) -> &[u8] {
    let mut lines = pgm.split(|byte| *byte == b'\n');
    let size = std::str::from_utf8(lines.nth(1).unwrap()).unwrap();
    let size: Vec<usize> = size.split(' ').map(|n| n.parse().unwrap()).collect();
    &pgm[pgm.len() - size[0] * size[1]..]
}

fn changed_cells(before: &MapState, after: &MapState) -> DifferingCells {
    let (before, after) = (pixels(&before.pgm), pixels(&after.pgm));
    assert_eq!(before.len(), after.len());
    let count = |changed: fn(u8, u8) -> bool| {
        let cells = before.iter().zip(after);
        cells.filter(|(then, now)| changed(**then, **now)).count() as u64
    };
    DifferingCells {
        to_free: count(|then, now| (then, now) == (OCCUPIED, FREE)),
        to_occupied: count(|then, now| (then, now) == (FREE, OCCUPIED)),
        to_unknown: count(|then, now| then != UNKNOWN && now == UNKNOWN),
        from_unknown: count(|then, now| then == UNKNOWN && now != UNKNOWN),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_preview_says_what_accepting_then_does_and_does_nothing_itself() {
    let (bench, alert) = Bench::with_alert().await;
    let before = bench.state().await;
    let preview = bench.decisions.preview(alert.id).await.unwrap();
    assert!(bench.state().await == before);
    assert_eq!(preview.alert, alert);

    let accepted = bench.decide(&alert, AlertAction::Accept).await;
    let after = bench.state().await;
    assert_eq!(preview.map_version_next, 2);
    let edges = before.edges.iter().zip(&after.edges);
    let retired = edges.filter(|(_, now)| now.status == EdgeStatus::Retired);
    let retired: Vec<_> = retired.map(|(edge, _)| edge.id).collect();
    assert!(!retired.is_empty());
    assert_eq!(preview.edges_retired, retired);
    let nodes = || before.nodes.iter().zip(&after.nodes);
    let handed_over = nodes().filter(|(then, now)| then.reference != now.reference);
    assert_eq!(preview.nodes_handed_over, handed_over.count());
    let moved_m =
        nodes().map(|(then, now)| (now.pose.x - then.pose.x).hypot(now.pose.y - then.pose.y));
    assert_eq!(preview.max_displacement_m, moved_m.fold(0.0, f64::max));
    assert!(preview.max_displacement_m > 0.0);
    assert_eq!(preview.cells, changed_cells(&before, &after));
    assert!(preview.cells.to_occupied > 0, "{:?}", preview.cells);
    assert_eq!(preview.nodes_reactivated, 0);

    let refused = bench.decisions.preview(alert.id).await.unwrap_err();
    assert!(matches!(refused, DecisionError::NotAllowed(now) if *now == accepted));
}

/// What is computed after a preview is what it would have been without.
#[tokio::test(flavor = "multi_thread")]
async fn a_preview_leaves_no_trace_in_what_follows() {
    let (plain, _) = Bench::with_alert().await;
    let (previewed, alert) = Bench::with_alert().await;
    previewed.decisions.preview(alert.id).await.unwrap();
    for bench in [&plain, &previewed] {
        bench.lap("later", 2, 1, |map| vec![box_finding(map)]).await;
    }
    assert!(plain.state().await == previewed.state().await);
}
