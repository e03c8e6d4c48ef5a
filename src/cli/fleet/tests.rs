use serde_json::json;

use super::*;
use crate::cli::plan::{PlanArgs, WorldKind};
use crate::client::pretend::{Faults, Pretend};

fn plan(laps: u8) -> Plan {
    let arguments = PlanArgs {
        world: WorldKind::Hall,
        laps,
        vehicles: 2,
        changes: 3,
        change_lap: None,
        walkers: 1,
        path_noise: 0.3,
        seed: 1,
        faulty: false,
    };
    arguments.plan().unwrap()
}

fn now() -> Timestamp {
    "2026-11-21T06:00:00Z".parse().unwrap()
}

#[test]
fn a_fleet_is_ready_to_be_sent() {
    let plan = plan(2);
    let fleet = Fleet::new(&plan, now()).unwrap();
    let per_lap = (plan.scene.route.length_m() / 0.25).floor() as usize;
    assert_eq!(fleet.batch_count(), 4 * per_lap.div_ceil(30));
    let truth = &fleet.truth.changes;
    assert!(!truth.is_empty());
    assert!(truth.iter().all(|event| event.lap == 1));
    let again = Fleet::new(&plan, now()).unwrap();
    for (a, b) in fleet.drives.iter().zip(&again.drives) {
        assert!(
            a.batches
                .iter()
                .zip(&b.batches)
                .all(|(a, b)| { a.encoded.id == b.encoded.id && a.encoded.gzip == b.encoded.gzip })
        );
    }
    let first = &fleet.drives[0];
    assert_eq!(
        first.batches[0].encoded.id.as_str(),
        "agv-01-20261121T060000-1-00000"
    );
    assert_eq!(
        first.batches[per_lap.div_ceil(30)].encoded.id.as_str(),
        "agv-01-20261121T060000-2-00000"
    );
}

/// The stamps of a batch that the service has.
fn stamps(batch: &serde_json::Value) -> Vec<Timestamp> {
    let scans = batch["scans"].as_array().unwrap();
    let stamp = |s: &serde_json::Value| s["stamp"].as_str().unwrap().parse().unwrap();
    scans.iter().map(stamp).collect()
}

#[tokio::test]
async fn a_fleet_drives_and_tells_what_was_left_out() {
    let service = Pretend::start(Faults {
        unanchored: Some("agv-02"),
        ..Faults::default()
    })
    .await;
    let fleet = Fleet::new(&plan(2), now()).unwrap();
    let gateway = Gateway::new(&service.url, None, say).unwrap();
    let route = RouteId::new("demo-hall").unwrap();
    assert!(gateway.ensure_route(&route, Some("Hall")).await.unwrap());
    fleet.drive(&gateway, &route, Duration::ZERO).await.unwrap();
    let settled = fleet.settle(&gateway, &route).await.unwrap();
    assert_eq!(settled.left_out.len(), fleet.batch_count() / 2);
    assert!(settled.left_out[0].ends_with("is unanchored: not recognised"));
    fleet.report(&gateway, &route).await.unwrap();

    let state = service.state.lock().unwrap();
    assert_eq!(state.batches.len(), fleet.batch_count());
    // Each lap begins with a start pose, but for the first one of the second vehicle.
    let with_start = state
        .batches
        .iter()
        .filter(|(_, b)| !b["initial_pose"].is_null());
    let with_start: Vec<&str> = with_start.map(|(id, _)| id.as_str()).collect();
    assert_eq!(with_start.len(), 3);
    assert!(
        with_start
            .iter()
            .all(|id| id.ends_with("-00000") && !id.ends_with("02-20261121T060000-1-00000"))
    );
    let mut laps = [const { Vec::new() }; 2];
    for drive in &fleet.drives {
        let batches = drive.batches.iter();
        let all = batches
            .clone()
            .map(|b| &state.batches[b.encoded.id.as_str()]);
        let all: Vec<_> = all.flat_map(stamps).collect();
        assert!(all.is_sorted_by(|a, b| a < b));
        for batch in batches {
            laps[batch.lap].extend(stamps(&state.batches[batch.encoded.id.as_str()]));
        }
    }
    // No vehicle is in its second lap before all have ended their first.
    assert!(laps[0].iter().max() < laps[1].iter().min());
    assert_eq!(laps[1].iter().max(), Some(&now()));
}

#[tokio::test]
async fn an_alert_is_reported_once_for_each_status() {
    let service = Pretend::start(Faults::default()).await;
    let gateway = Gateway::new(&service.url, None, say).unwrap();
    let route = RouteId::new("demo-hall").unwrap();
    let mut watch = AlertWatch::default();
    assert!(watch.news(&gateway, &route).await.unwrap().is_empty());
    let alert = |id: u8, status: &str| {
        json!({"id": id.to_string(), "kind": "appeared", "status": status, "confidence": 0.9,
               "title": "Appeared: about 0.9 × 0.4 m", "vehicle_ids": ["agv-01"],
               "location": {"x": 1.0, "y": 2.0, "sigma": 0.05}})
    };
    let steps: [&[&str]; 3] = [&["open"], &["open", "open"], &["resolved", "open"]];
    for (k, statuses) in steps.iter().enumerate() {
        let alerts = (0..).zip(*statuses).map(|(id, status)| alert(id, status));
        service.state.lock().unwrap().alerts = Some(alerts.collect());
        let news = watch.news(&gateway, &route).await.unwrap();
        let status = ["open", "open", "resolved"][k];
        assert_eq!(
            news,
            [format!(
                "ALERT {status}: Appeared: about 0.9 × 0.4 m at (1.00, 2.00)"
            )]
        );
    }
    assert!(watch.news(&gateway, &route).await.unwrap().is_empty());
}
