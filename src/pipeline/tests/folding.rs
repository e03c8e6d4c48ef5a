use super::bench::{Bench, box_finding, route, stamp_of_hour};
use crate::change::series::{ClosureSample, SeriesEntry, residual_series};
use crate::change::{AlertStatus, ChangeKind, Detector, Finding};
use crate::geometry::Vector2;
use crate::ids::{BatchId, VehicleId};
use crate::mapping::Mending;
use crate::store::{AlertFilter, SYSTEM};

#[tokio::test(flavor = "multi_thread")]
async fn an_alert_says_what_is_known() {
    let (bench, alert) = Bench::with_alert().await;
    assert_eq!((alert.revision, alert.status), (1, AlertStatus::Open));
    assert_eq!(alert.vehicles, [VehicleId::new("agv-1").unwrap()]);
    assert_eq!(
        (alert.map_version, alert.first_seen),
        (1, alert.evidence.since)
    );
    assert_eq!(alert.history.len(), 1);
    assert_eq!(alert.history[0].by, SYSTEM);
    assert_eq!(alert.id.0.get_version_num(), 7);

    // Of the alert's closures it is the least likely one in the series of its sub-graph.
    let residual = alert.residual.unwrap();
    let store = &bench.engine.store;
    let edges = store.edges(&route()).await.unwrap();
    let of_residual = edges.iter().find(|edge| edge.id == residual.edge_id);
    let subgraph_id = of_residual.unwrap().subgraph_id.unwrap();
    let of_subgraph = edges.iter().filter(|e| e.subgraph_id == Some(subgraph_id));
    let samples = of_subgraph.filter_map(|edge| {
        Some(ClosureSample {
            edge_id: edge.id,
            delta_f: edge.delta_f?,
        })
    });
    let samples: Vec<_> = samples.collect();
    let series = residual_series(&samples, &Detector::Fused.series_params());
    let of_alert = |e: &&SeriesEntry| alert.evidence.edges.contains(&e.edge_id);
    let entries = series.entries.iter().filter(of_alert);
    let strongest = entries.min_by(|a, b| a.p_value.total_cmp(&b.p_value));
    let strongest = strongest.unwrap();
    assert_eq!(residual.edge_id, strongest.edge_id);
    assert_eq!(
        (residual.delta_f, residual.threshold, residual.p_value),
        (strongest.delta_f, strongest.threshold, strongest.p_value)
    );
    let record = store.route(&route()).await.unwrap().unwrap();
    assert_eq!(record.counts.open_alerts, 1);
    for batch in ["before", "after"] {
        let batch = BatchId::new(batch).unwrap();
        let alerts = store.batch_alerts(&route(), &batch).await.unwrap();
        assert_eq!(alerts, [alert.id]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn alerts_outlive_a_restart_and_go_on() {
    let (bench, alert) = Bench::with_alert().await;
    let bench = bench.restarted().await;
    assert_eq!(bench.alerts().await, std::slice::from_ref(&alert));
    // The same findings again are no news, whatever was read back from the disk.
    let evidence = alert.evidence.clone();
    bench.lap("later", 2, 1, |_| vec![evidence.clone()]).await;
    assert_eq!(bench.alerts().await, std::slice::from_ref(&alert));
    let gone = Finding {
        until: Some(stamp_of_hour(3)),
        ..alert.evidence.clone()
    };
    bench.lap("gone", 3, 1, |_| vec![gone.clone()]).await;
    let resolved = bench.alerts().await.remove(0);
    assert_eq!(resolved.status, AlertStatus::Resolved);
    assert_eq!(resolved.history.len(), 2);
    let bench = bench.restarted().await;
    bench.lap("back", 4, 1, |_| vec![evidence.clone()]).await;
    let back = bench.alerts().await;
    assert_eq!(back.len(), 1);
    assert_eq!((back[0].id, back[0].status), (alert.id, AlertStatus::Open));
}

#[tokio::test(flavor = "multi_thread")]
async fn alerts_are_listed_newest_first_and_reported_in_order() {
    let bench = Bench::new().await;
    bench.lap("before", 0, 1, |_| Vec::new()).await;
    let at = |map: &_, x_m: f64| {
        let mut finding = box_finding(map);
        let shift = Vector2::new(x_m, 0.0);
        finding.location += shift;
        finding
            .region
            .iter_mut()
            .for_each(|corner| *corner += shift);
        finding.confidence = 0.9 + x_m / 100.0;
        finding
    };
    bench
        .lap("after", 1, 1, |map| {
            vec![at(map, 0.0), at(map, 1.5), at(map, 5.0)]
        })
        .await;
    let all = bench.alerts().await;
    let places: Vec<f64> = all.iter().map(|a| a.evidence.location.x).collect();
    assert_eq!(places, [11.0, 7.5, 6.0]);
    assert_eq!(all[2].related, []);
    let store = &bench.engine.store;
    let page = |filter: AlertFilter, before, limit| async move {
        let page = store.alert_page(&filter, before, limit).await.unwrap();
        page.into_iter()
            .map(|a| a.evidence.location.x)
            .collect::<Vec<_>>()
    };
    let any = AlertFilter::default;
    assert_eq!(page(any(), None, 2).await, [11.0, 7.5]);
    assert_eq!(page(any(), Some(all[1].id), 2).await, [6.0]);
    let bbox = Some([7.0, 0.0, 11.0, 1.0]);
    assert_eq!(
        page(AlertFilter { bbox, ..any() }, None, 9).await,
        [11.0, 7.5]
    );
    let min_confidence = Some(0.93);
    assert_eq!(
        page(
            AlertFilter {
                min_confidence,
                ..any()
            },
            None,
            9
        )
        .await,
        [11.0]
    );
    let status = Some(AlertStatus::Resolved);
    assert!(
        page(AlertFilter { status, ..any() }, None, 9)
            .await
            .is_empty()
    );
    let since = Some(all[0].updated_at);
    assert_eq!(page(AlertFilter { since, ..any() }, None, 9).await.len(), 3);

    let events = store.alert_events(None, 0, 10).await.unwrap();
    let raised: Vec<_> = events.iter().map(|event| event.alert_id).collect();
    assert_eq!(raised, [all[2].id, all[1].id, all[0].id]);
    bench
        .decide(&all[0], crate::change::AlertAction::Dismiss)
        .await;
    let last = store.last_alert_event().await.unwrap();
    let next = store
        .alert_events(Some(&route()), events[2].sequence, 10)
        .await
        .unwrap();
    assert_eq!(next.len(), 1);
    assert_eq!(
        (next[0].sequence, next[0].alert_id, next[0].revision),
        (last, all[0].id, 2)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_mended_is_resolved_and_says_by_how_much() {
    let bench = Bench::new().await;
    let mismatch = |finding: Finding| Finding {
        kind: ChangeKind::MapMismatch,
        shift: Some(Vector2::new(0.4, 0.0)),
        ..finding
    };
    bench.lap("before", 0, 1, |_| Vec::new()).await;
    bench
        .lap("after", 1, 1, |map| vec![mismatch(box_finding(map))])
        .await;
    let raised = bench.alerts().await.remove(0);
    assert_eq!(raised.status, AlertStatus::Open);
    let mut never_raised = raised.evidence.clone();
    for corner in &mut never_raised.region {
        corner.x += 30.0;
    }
    let mended = [raised.evidence.clone(), never_raised].map(|mismatch| Mending {
        mismatch,
        shift: Vector2::new(0.412, -0.02),
        closures: Vec::new(),
        quarantined: Vec::new(),
    });
    bench
        .mended_lap("later", 2, 1, |_| (Vec::new(), mended.to_vec()))
        .await;
    let bench = bench.restarted().await;
    let mut alerts = bench.alerts().await;
    alerts.sort_by_key(|alert| alert.id != raised.id);
    let note = "closures mended the map: the segment was moved by (0.41, -0.02) m";
    for (alert, revision) in alerts.iter().zip([2, 1]) {
        assert_eq!(
            (alert.status, alert.revision),
            (AlertStatus::Resolved, revision)
        );
        let statuses: Vec<_> = alert.history.iter().map(|entry| entry.status).collect();
        assert_eq!(statuses, [AlertStatus::Open, AlertStatus::Resolved]);
        let last = alert.history.last().unwrap();
        assert_eq!(
            (last.note.as_deref(), last.by.as_str()),
            (Some(note), SYSTEM)
        );
    }
    assert_eq!(alerts.len(), 2);
    // What happens to one within a job is one revision.
    let stands = mended[0].mismatch.clone();
    bench.lap("third", 3, 1, |_| vec![stands.clone()]).await;
    let again = (vec![stands.clone()], vec![mended[0].clone()]);
    bench.mended_lap("fourth", 4, 1, |_| again.clone()).await;
    let mut alerts = bench.alerts().await;
    alerts.sort_by_key(|alert| alert.id != raised.id);
    assert_eq!((alerts.len(), alerts[0].revision), (2, 4));
    assert_eq!(alerts[0].status, AlertStatus::Open);
    assert_eq!(alerts[0].history.len(), 5);
}
