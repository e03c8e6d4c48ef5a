//! Uploads of edges alone: what a vehicle that matches scans itself gets for them.

use mapshift::geometry::Pose2;
use mapshift::ingest::g2o::read_g2o;
use mapshift::solver::{SolveOptions, solve};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::drives::two_vehicles;
use crate::edge_laps::{Displaced, LAP, Laps};
use crate::running::Running;
use crate::state::{State, pose_of};

async fn put(service: &Running, id: &str, batch: &Value) {
    let (status, answer) = service.client.put_edges("line", id, batch).await;
    assert_eq!(status, 202, "{answer}");
}

async fn put_merged(service: &Running, id: &str, batch: &Value) -> Value {
    put(service, id, batch).await;
    let batch = service.client.ended("line", id).await;
    assert_eq!(batch["status"], "merged", "{batch}");
    batch
}

async fn started() -> Running {
    let service = Running::start().await;
    service.client.put_route("line", Value::Null).await;
    service
}

/// That the service's graph is at the optimum of the drive's.
async fn assert_optimal(service: &Running, laps: &Laps) {
    let text = service.client.text("/v1/routes/line/graph.g2o").await;
    let reported = read_g2o(&text).unwrap().graph;
    let mut expected = laps.graph();
    solve(&mut expected, &SolveOptions::default());
    let (cost, optimum) = (reported.cost(), expected.cost());
    assert!(
        (cost - optimum).abs() <= 1e-9 * optimum,
        "{cost} for {optimum}"
    );
    assert_eq!(reported.nodes().len(), expected.nodes().len());
    let state = State::of(&service.client, "line").await;
    for node in &state.nodes {
        let k: usize = node["client_id"].as_str().unwrap().parse().unwrap();
        let apart = pose_of(&node["pose"]).between(&expected.nodes()[k].pose);
        // A solve ends when a step promises 10⁻¹⁰ of F: a micrometre or two are left.
        assert!(
            apart.translation().norm() < 1e-5 && apart.theta.abs() < 1e-5,
            "{node} is {apart:?} off"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn edges_in_batches_make_the_optimum_of_the_whole() {
    let service = started().await;
    let laps = Laps::drive("agv-1", 3, 1, &Displaced::nowhere());
    let batches = laps.batches();
    for (k, batch) in batches.iter().enumerate() {
        let merged = put_merged(&service, &format!("b{k}"), batch).await;
        assert_eq!(merged["kind"], "edges");
        assert_eq!(merged["trip_id"], "agv-1-drive");
        assert_eq!(
            (&merged["sequence"], &merged["scans"]),
            (&json!(k), &json!(0))
        );
        assert_eq!(merged["nodes_added"], LAP);
        assert_eq!(merged["loop_closures"], if k == 0 { 0 } else { LAP });
    }
    assert_optimal(&service, &laps).await;

    let client = &service.client;
    let before = State::of(client, "line").await;
    let (status, replayed) = client.put_edges("line", "b1", &batches[1]).await;
    assert_eq!((status, &replayed["status"]), (200, &json!("merged")));
    let (status, problem) = client.put_edges("line", "b1", &batches[2]).await;
    assert_eq!(
        (status, &problem["type"]),
        (409, &json!("/problems/batch-id-reused"))
    );
    assert!(State::of(client, "line").await == before);

    let counts = &client.route("line").await["counts"];
    let edges = laps.motions.len();
    assert_eq!(
        (&counts["nodes"], &counts["edges"]),
        (&json!(3 * LAP), &json!(edges))
    );
    assert_eq!(
        (&counts["scans"], &counts["loop_closures"]),
        (&json!(0), &json!(2 * LAP))
    );
    let series = client.json("/v1/routes/line/residuals").await;
    let entries = series["entries"].as_array().unwrap();
    assert_eq!(entries.len(), 2 * LAP);
    let total = entries[2 * LAP - 1]["total"].as_f64().unwrap();
    let residuals = before.edges.iter().map(|e| e["residual"].as_f64().unwrap());
    assert!((total - residuals.sum::<f64>()).abs() < 1e-6 * total);
    service.stop().await;
}

/// What reads nodes bears nodes without a scan.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_without_scans_can_be_read() {
    let service = started().await;
    let laps = Laps::drive("agv-1", 2, 2, &Displaced::nowhere());
    for (k, batch) in laps.batches().iter().enumerate() {
        put_merged(&service, &format!("b{k}"), batch).await;
    }
    let client = &service.client;
    let nodes = client.list("/v1/routes/line/nodes", 50).await;
    assert_eq!(nodes.len(), 2 * LAP);
    assert_eq!(nodes[7]["client_id"], "7");
    let id = nodes[7]["id"].as_i64().unwrap();
    let (status, problem) = client
        .get_any(&format!("/v1/routes/line/nodes/{id}/scan"))
        .await;
    assert_eq!(
        (status, &problem["type"]),
        (404, &json!("/problems/not-found"))
    );
    assert!(
        problem["detail"]
            .as_str()
            .unwrap()
            .contains("it has no scan"),
        "{problem}"
    );
    for path in [
        "map.png",
        "map.pgm",
        "map.yaml",
        "versions",
        "subgraphs",
        "residuals",
    ] {
        let status = client.status_of(&format!("/v1/routes/line/{path}")).await;
        assert_eq!(status, 200, "{path}");
    }
    let trip = "/v1/routes/line/trajectories/agv-1-drive";
    let poses = client.json(trip).await["poses"].as_array().unwrap().len();
    assert_eq!(poses, 2 * LAP);
    assert_eq!(
        client.text(&format!("{trip}/tum")).await.lines().count(),
        2 * LAP
    );
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_waits_for_the_nodes_that_it_names() {
    let service = started().await;
    let client = &service.client;
    let laps = Laps::drive("agv-1", 4, 3, &Displaced::nowhere());
    let batches = laps.batches();
    // Into an empty map: the first to come is tied to nothing that is there.
    for k in [3, 1] {
        put(&service, &format!("b{k}"), &batches[k]).await;
        let waiting = client.ended("line", &format!("b{k}")).await;
        assert_eq!(waiting["status"], "unanchored", "{waiting}");
        let reason = waiting["reason"].as_str().unwrap();
        assert!(
            reason.contains("which vehicle agv-1 has not brought yet"),
            "{reason}"
        );
    }
    // Another vehicle's node of the same name is another node.
    let other = json!({
        "vehicle_id": "agv-2",
        "nodes": [{"id": 119, "pose": {"x": 0.0, "y": 0.0, "theta": 0.0}}],
        "edges": [],
    });
    put(&service, "b0", &batches[0]).await;
    assert_eq!(client.ended("line", "b0").await["status"], "merged");
    assert_eq!(client.batch("line", "b1").await["status"], "merged");
    put(&service, "other", &other).await;
    let other = client.ended("line", "other").await;
    assert_eq!(other["status"], "unanchored");
    assert!(
        other["reason"]
            .as_str()
            .unwrap()
            .contains("is not connected"),
        "{other}"
    );
    assert_eq!(client.batch("line", "b3").await["status"], "unanchored");
    put_merged(&service, "b2", &batches[2]).await;
    let last = client.batch("line", "b3").await;
    assert_eq!(
        (&last["status"], &last["reason"]),
        (&json!("merged"), &Value::Null)
    );
    assert_optimal(&service, &laps).await;

    // What came once cannot come again.
    let mut again = batches[1].clone();
    again["edges"] = json!([]);
    put(&service, "again", &again).await;
    let again = client.ended("line", "again").await;
    assert_eq!(again["status"], "quarantined");
    assert!(
        again["reason"]
            .as_str()
            .unwrap()
            .contains("came with an earlier batch"),
        "{again}"
    );
    service.stop().await;
}

/// A part that hangs on a part that hangs on nothing is waited for until both are tied.
#[tokio::test(flavor = "multi_thread")]
async fn what_hangs_together_is_tied_together() {
    let service = started().await;
    let client = &service.client;
    let laps = Laps::drive("agv-1", 2, 4, &Displaced::nowhere());
    put_merged(&service, "first", &laps.batch(0..20)).await;
    let mut island = laps.batch(30..40);
    let edges = island["edges"].as_array_mut().unwrap();
    edges.retain(|edge| edge["from"] != "29");
    put(&service, "island", &island).await;
    assert_eq!(client.ended("line", "island").await["status"], "unanchored");
    let mut bridge = laps.batch(20..30);
    let tie = laps.batch(30..31)["edges"][0].clone();
    bridge["edges"].as_array_mut().unwrap().push(tie);
    put_merged(&service, "bridge", &bridge).await;
    assert_eq!(client.batch("line", "island").await["status"], "merged");
    let island = client.batch("line", "island").await;
    assert_eq!(island["nodes_added"], 10);
    put_merged(&service, "rest", &laps.batch(40..80)).await;
    assert_optimal(&service, &laps).await;
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn scans_and_edges_share_a_map() {
    let service = started().await;
    let client = &service.client;
    let drives = two_vehicles(36);
    client.put_all("line", &drives[0].batches(12)).await;
    client.merged("line").await;
    let scanned = State::of(client, "line").await;
    let first = scanned.nodes[0]["id"].as_i64().unwrap();
    let step = json!({"x": 1.0, "y": 0.0, "theta": 0.0});
    let information = [2500.0, 0.0, 0.0, 2500.0, 0.0, 1e4];
    let edge = |from: String, to: &str, kind: &str| json!({"from": from, "to": to, "measurement": step, "information": information, "kind": kind});
    let batch = json!({
        "vehicle_id": "tugger",
        "nodes": [{"id": "a", "pose": step}, {"id": "b", "pose": step}],
        "edges": [edge(format!("map:{first}"), "a", "loop_closure"), edge("a".into(), "b", "odometry")],
    });
    let merged = put_merged(&service, "tug", &batch).await;
    assert_eq!(merged["trip_id"], "tug");
    // The second vehicle's scans find their places as if nothing had come in between.
    client.put_all("line", &drives[1].batches(12)).await;
    client.merged("line").await;
    let state = State::of(client, "line").await;
    let of = |name: &str| {
        let named = |node: &&Value| node["client_id"] == name;
        pose_of(&state.nodes.iter().find(named).unwrap()["pose"])
    };
    let expected = pose_of(&state.nodes[0]["pose"]).compose(&Pose2::new(1.0, 0.0, 0.0));
    assert!(of("a").between(&expected).translation().norm() < 1e-9);
    let expected = expected.compose(&Pose2::new(1.0, 0.0, 0.0));
    assert!(of("b").between(&expected).translation().norm() < 1e-9);
    let closures = state.edges.iter().filter(|e| e["kind"] == "loop_closure");
    assert!(closures.filter(|e| !e["closure"].is_null()).count() > 5);
    let alerts = client.json("/v1/alerts?route_id=line").await;
    assert_eq!(alerts["items"], json!([]));

    // A trip has one kind.
    let mut mixed = batch.clone();
    mixed["trip_id"] = json!(drives[0].trip);
    mixed["vehicle_id"] = json!(drives[0].vehicle);
    put(&service, "mixed", &mixed).await;
    let mixed = client.ended("line", "mixed").await;
    assert_eq!(mixed["status"], "quarantined");
    assert!(
        mixed["reason"].as_str().unwrap().contains("has scans"),
        "{mixed}"
    );
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_in_between_changes_no_bit() {
    let displaced = Displaced {
        laps: 7..9,
        places: 10..14,
        by: Pose2::new(0.4, 0.2, 0.0),
    };
    let laps = Laps::drive("agv-1", 9, 5, &displaced);
    let mut reported = Vec::new();
    for restarts in [false, true] {
        let directory = TempDir::new().unwrap();
        let mut service = Running::start_in(directory.path()).await;
        service.client.put_route("line", Value::Null).await;
        for (k, batch) in laps.batches().iter().enumerate() {
            put_merged(&service, &format!("b{k}"), batch).await;
            if restarts {
                service.stop().await;
                service = Running::start_in(directory.path()).await;
            }
        }
        let mut alerts = service.client.json("/v1/alerts?route_id=line").await["items"].take();
        for alert in alerts.as_array_mut().unwrap() {
            for field in ["id", "raised_at", "updated_at", "history"] {
                alert[field] = Value::Null;
            }
        }
        reported.push((State::of(&service.client, "line").await, alerts));
        service.stop().await;
    }
    assert!(
        reported[0].0 == reported[1].0,
        "{:?}",
        reported[0].0.distance_to(&reported[1].0)
    );
    assert_eq!(reported[0].1, reported[1].1);
    assert_eq!(reported[0].1.as_array().unwrap().len(), 1);
}

/// The alerts after laps of which some closures are off.
async fn alerts_of(displaced: &Displaced, laps: usize, seed: u64) -> (Running, Vec<Value>) {
    let service = started().await;
    let laps = Laps::drive("agv-1", laps, seed, displaced);
    for (k, batch) in laps.batches().iter().enumerate() {
        put_merged(&service, &format!("b{k}"), batch).await;
    }
    let alerts = service.client.list("/v1/alerts", 100).await;
    (service, alerts)
}

#[tokio::test(flavor = "multi_thread")]
async fn displaced_closures_raise_one_alert_at_their_place() {
    for seed in 11..14 {
        let displaced = Displaced {
            laps: 7..9,
            places: 10..15,
            by: Pose2::new(0.3, 0.15, 0.0),
        };
        let (service, alerts) = alerts_of(&displaced, 9, seed).await;
        assert_eq!(alerts.len(), 1, "seed {seed}: {alerts:#?}");
        let alert = &alerts[0];
        assert_eq!(
            (&alert["kind"], &alert["status"]),
            (&json!("residual"), &json!("open"))
        );
        let truth = Laps::drive("agv-1", 1, seed, &Displaced::nowhere()).truth;
        let at = pose_of(
            &json!({"x": alert["location"]["x"], "y": alert["location"]["y"], "theta": 0.0}),
        );
        let place_m = (at.translation() - truth[12].translation()).norm();
        assert!(place_m < 3.0, "seed {seed}: {place_m} m off");
        assert!(alert["confidence"].as_f64().unwrap() > 0.9, "{alert}");
        evidence_is_reported(&service, alert).await;
        service.stop().await;
    }
}

async fn evidence_is_reported(service: &Running, alert: &Value) {
    let path = format!("/v1/alerts/{}/evidence", alert["id"].as_str().unwrap());
    let evidence = service.client.json(&path).await;
    assert_eq!(evidence["scans"], json!([]));
    assert_eq!(evidence["edge_id"], alert["residual"]["edge_id"]);
    let entries = evidence["residuals"]["entries"].as_array().unwrap();
    let reported = entries
        .iter()
        .find(|e| e["edge_id"] == evidence["edge_id"])
        .unwrap();
    assert_eq!(
        (&reported["alarm"], reported["calibrated_p_value"].is_f64()),
        (&json!(true), true)
    );
    let picture = service.client.text(&format!("{path}.svg")).await;
    assert!(picture.contains("no scans"), "{picture}");
}

#[tokio::test(flavor = "multi_thread")]
async fn laps_that_agree_raise_nothing() {
    for seed in 21..24 {
        let (service, alerts) = alerts_of(&Displaced::nowhere(), 9, seed).await;
        assert_eq!(alerts, Vec::<Value>::new(), "seed {seed}");
        service.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_alert_ends_by_itself_when_laps_agree_again() {
    let displaced = Displaced {
        laps: 7..8,
        places: 10..15,
        by: Pose2::new(0.3, 0.15, 0.0),
    };
    let (service, alerts) = alerts_of(&displaced, 9, 31).await;
    assert_eq!(alerts.len(), 1, "{alerts:#?}");
    assert_eq!(alerts[0]["status"], "resolved", "{alerts:#?}");
    service.stop().await;
}

/// By the paper's rule edges are weighed alike, whatever they say.
#[tokio::test(flavor = "multi_thread")]
async fn the_paper_s_rule_works_on_edges_alone() {
    let service = Running::start().await;
    service
        .client
        .put_route("line", json!({"detector": "seed"}))
        .await;
    let displaced = Displaced {
        laps: 8..10,
        places: 10..15,
        by: Pose2::new(0.4, 0.1, 0.0),
    };
    let laps = Laps::drive("agv-1", 10, 41, &displaced);
    for (k, batch) in laps.batches().iter().enumerate() {
        put_merged(&service, &format!("b{k}"), batch).await;
    }
    let state = State::of(&service.client, "line").await;
    let identity = json!([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
    assert!(
        state
            .edges
            .iter()
            .all(|edge| edge["information"] == identity)
    );
    let alerts = service.client.list("/v1/alerts", 100).await;
    assert!(!alerts.is_empty());
    assert!(
        alerts.iter().all(|alert| alert["kind"] == "residual"),
        "{alerts:#?}"
    );
    service.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_residual_alert_can_be_accepted_and_taken_back() {
    let displaced = Displaced {
        laps: 7..9,
        places: 10..15,
        by: Pose2::new(0.3, 0.15, 0.0),
    };
    let (service, alerts) = alerts_of(&displaced, 9, 11).await;
    let client = &service.client;
    let before = State::of(client, "line").await;
    let accepted = client.decide(&alerts[0], "accept").await;
    assert_eq!(accepted["status"], "accepted");
    let state = State::of(client, "line").await;
    let retired = state.edges.iter().filter(|e| e["status"] == "retired");
    assert!(retired.count() >= 2);
    assert_eq!(client.route("line").await["map_version"], 2);
    let undone = client.decide(&accepted, "undo").await;
    assert_eq!(undone["status"], "open");
    assert!(State::of(client, "line").await == before);
    service.stop().await;
}
