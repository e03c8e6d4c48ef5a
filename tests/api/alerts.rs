//! Alerts as clients see them, and what clients decide about them.

use std::time::Duration;

use mapshift::api::Limits;
use mapshift::ids::OperationId;
use mapshift::model::{Actor, AlertAction};
use mapshift::store::{DecisionRequest, DecisionsRequest, OperationRequest, Store, StoreOptions};
use serde_json::{Value, json};

use crate::changed_hall::{self, APPEARED, DISAPPEARED};
use crate::client::{Answer, Request};
use crate::resources::steady;
use crate::service::Service;

/// Sines and cosines may differ in their last bits from machine to machine.
fn rounded(mut value: Value) -> Value {
    fn visit(value: &mut Value) {
        match value {
            Value::Object(fields) => fields.values_mut().for_each(visit),
            Value::Array(items) => items.iter_mut().for_each(visit),
            Value::Number(number) if number.is_f64() => {
                let rounded = (number.as_f64().unwrap() * 1e6).round() / 1e6;
                *value = json!(rounded + 0.0);
            }
            _ => {}
        }
    }
    visit(&mut value);
    value
}

fn path(alert: &str) -> String {
    format!("/v1/alerts/{alert}")
}

async fn decide(service: &Service, action: &str, tag: &str, body: Value) -> Answer {
    let path = format!("{}/{action}", path(APPEARED));
    let request = Request::new("POST", path).header("if-match", tag);
    service.send(request.json(&body)).await
}

#[tokio::test]
async fn alerts_have_the_documented_form() {
    let service = changed_hall::start().await;
    for (name, path) in [
        ("alert", path(APPEARED)),
        ("alerts", "/v1/alerts?limit=1".to_owned()),
        ("alert_passes", format!("{}/passes", path(APPEARED))),
        ("alert_evidence", format!("{}/evidence", path(APPEARED))),
        (
            "batch_with_alerts",
            "/v1/routes/hall/batches/b-0".to_owned(),
        ),
        (
            "alerts_geojson",
            "/v1/alerts.geojson?route_id=hall".to_owned(),
        ),
    ] {
        let answer = service.get(&path).await;
        assert_eq!(answer.status, 200, "{name}");
        insta::assert_json_snapshot!(name, rounded(steady(answer.json())));
    }
    let batches = service.get("/v1/routes/hall/batches").await.json();
    assert_eq!(
        batches["items"][0]["alerts"],
        json!([APPEARED, DISAPPEARED])
    );
    let route = service.get("/v1/routes/hall").await.json();
    assert_eq!(route["counts"]["open_alerts"], 1);
    service.stop().await;
}

/// Observations with the count and the sum of what is said of cells in place of thousands of numbers.
fn summed(mut observations: Value) -> Value {
    for side in ["before", "since"] {
        for of_cells in ["cells", "hits", "misses"] {
            let numbers = observations[side][of_cells].as_array().unwrap();
            let sum: u64 = numbers.iter().map(|number| number.as_u64().unwrap()).sum();
            observations[side][of_cells] = json!({"count": numbers.len(), "sum": sum});
        }
        let counts = ["cells", "hits", "misses"].map(|of| observations[side][of]["count"].clone());
        assert!(counts.iter().all(|count| *count == counts[0]), "{counts:?}");
    }
    observations
}

#[tokio::test]
async fn observations_show_a_place_before_the_change_and_since() {
    let service = changed_hall::start().await;
    let path = format!("{}/observations", path(APPEARED));
    let observations = service.get(&path).await;
    let observed = rounded(summed(observations.json()));
    insta::assert_json_snapshot!("alert_observations", observed);
    let tag = observations.header("etag").unwrap();
    let again = Request::new("GET", &*path).header("if-none-match", tag);
    assert_eq!(service.send(again).await.status, 304);
    for show in ["", "?show=before", "?show=since", "?show=both"] {
        let picture = service.get(&format!("{path}.svg{show}")).await;
        assert_eq!(picture.status, 200, "{show}");
        assert_eq!(picture.header("content-type"), Some("image/svg+xml"));
        let policy = picture.header("content-security-policy").unwrap();
        assert!(policy.contains("sandbox"));
        assert_ne!(picture.header("etag"), Some(tag), "{show}");
        let text = picture.text();
        assert_eq!(text.contains("observations before"), show != "?show=since");
        assert_eq!(text.contains("observation since"), show != "?show=before");
    }
    assert_eq!(
        service.get(&format!("{path}.svg?show=now")).await.status,
        400
    );
    service.stop().await;
}

#[tokio::test]
async fn an_alert_raised_before_passes_were_recorded_has_none() {
    let service = changed_hall::start().await;
    let alert = service.get(&path(DISAPPEARED)).await.json();
    assert_eq!(
        (&alert["passes"], &alert["blocking"]),
        (&Value::Null, &Value::Null)
    );
    let passes = service.get(&format!("{}/passes", path(DISAPPEARED))).await;
    assert_eq!(passes.json(), json!({"items": [], "next_cursor": null}));
    service.stop().await;
}

#[tokio::test]
async fn an_unchanged_list_is_answered_304() {
    let service = changed_hall::start().await;
    let list = "/v1/alerts?limit=1";
    let first = service.get(list).await;
    let tag = first.header("etag").unwrap().to_owned();
    let ask = |path: &str| Request::new("GET", path).header("if-none-match", &tag);
    assert_eq!(service.send(ask(list)).await.status, 304);
    assert_eq!(
        service.send(ask("/v1/alerts")).await.status,
        200,
        "another list"
    );
    let acknowledged = decide(&service, "acknowledge", "\"1\"", json!({})).await;
    assert_eq!(acknowledged.status, 200);
    assert_eq!(service.send(ask(list)).await.status, 304, "another alert");
    let all = service.get("/v1/alerts?status=acknowledged").await;
    let tag = all.header("etag").unwrap();
    let ask = Request::new("GET", "/v1/alerts?status=acknowledged").header("if-none-match", tag);
    let reopened = decide(&service, "reopen", "\"2\"", json!({})).await;
    assert_eq!(reopened.status, 200);
    assert_eq!(service.send(ask).await.status, 200);
    service.stop().await;
}

#[tokio::test]
async fn the_evidence_contradicts_at_the_place_of_the_change() {
    let service = changed_hall::start().await;
    let evidence = service
        .get(&format!("{}/evidence", path(APPEARED)))
        .await
        .json();
    assert_eq!(evidence["edge_id"], 3);
    let [old, new] = &evidence["scans"].as_array().unwrap()[..] else {
        panic!("{evidence}");
    };
    assert_eq!((&old["node_id"], &new["node_id"]), (&json!(1), &json!(3)));
    let contradicted = |scan: &Value| {
        let beams = scan["beams"].as_array().unwrap().clone();
        let contradicted = beams
            .into_iter()
            .filter(|beam| beam["verdict"] == "contradicts");
        contradicted.collect::<Vec<_>>()
    };
    assert_eq!(contradicted(old), Vec::<Value>::new());
    assert!(contradicted(new).len() >= 3);
    for beam in contradicted(new) {
        let (x, y) = (beam["x"].as_f64().unwrap(), beam["y"].as_f64().unwrap());
        assert!(
            (1.49..2.11).contains(&x) && (0.69..1.31).contains(&y),
            "{x} {y}"
        );
    }
    // Without a closure the nodes are compared; nothing is said of residuals.
    let other = service
        .get(&format!("{}/evidence", path(DISAPPEARED)))
        .await
        .json();
    assert_eq!(
        (&other["edge_id"], &other["residuals"]),
        (&Value::Null, &Value::Null)
    );
    assert_eq!(other["scans"][1]["node_id"], 3);
    service.stop().await;
}

#[tokio::test]
async fn the_evidence_picture_loads_and_runs_nothing() {
    let service = changed_hall::start().await;
    let path = format!("{}/evidence.svg", path(APPEARED));
    let picture = service.get(&path).await;
    assert_eq!(picture.header("content-type"), Some("image/svg+xml"));
    assert!(
        picture
            .header("content-security-policy")
            .unwrap()
            .contains("sandbox")
    );
    insta::assert_snapshot!("alert_evidence_svg", picture.text());
    let tag = picture.header("etag").unwrap();
    let again = Request::new("GET", &*path).header("if-none-match", tag);
    assert_eq!(service.send(again).await.status, 304);
    let acknowledged = decide(&service, "acknowledge", "\"1\"", json!({})).await;
    assert_eq!(acknowledged.status, 200);
    let again = Request::new("GET", path).header("if-none-match", tag);
    assert_eq!(service.send(again).await.status, 200);
    service.stop().await;
}

#[tokio::test]
async fn every_condition_of_a_list_filters() {
    let service = changed_hall::start().await;
    for (query, expected) in [
        ("", vec![DISAPPEARED, APPEARED]),
        ("?route_id=hall", vec![DISAPPEARED, APPEARED]),
        ("?route_id=yard", vec![]),
        ("?status=open", vec![APPEARED]),
        ("?status=resolved&kind=disappeared", vec![DISAPPEARED]),
        ("?status=open&kind=disappeared", vec![]),
        ("?tier=tentative", vec![DISAPPEARED]),
        ("?tier=confirmed", vec![APPEARED]),
        ("?tier=tentative&kind=appeared", vec![]),
        ("?since=2026-11-20T06:00:10Z", vec![DISAPPEARED]),
        ("?since=2026-11-20T07:00:10%2B01:00", vec![DISAPPEARED]),
        ("?bbox=1,0.5,3,2", vec![APPEARED]),
        ("?bbox=-10,-10,10,10", vec![DISAPPEARED, APPEARED]),
        ("?min_confidence=0.95", vec![APPEARED]),
        ("?min_confidence=1", vec![]),
        ("?vehicle_id=agv-07", vec![DISAPPEARED, APPEARED]),
        ("?vehicle_id=agv-08", vec![]),
        ("?blocking=near", vec![APPEARED]),
        ("?blocking=blocking", vec![]),
    ] {
        let page = service.get(&format!("/v1/alerts{query}")).await.json();
        let items = page["items"].as_array().unwrap().iter();
        let ids: Vec<_> = items.map(|item| item["id"].as_str().unwrap()).collect();
        assert_eq!(ids, expected, "{query}");
        assert_eq!(page["next_cursor"], Value::Null);
    }
    let first = service.get("/v1/alerts?limit=1").await.json();
    let cursor = first["next_cursor"].as_str().unwrap();
    let second = service
        .get(&format!("/v1/alerts?limit=1&cursor={cursor}"))
        .await
        .json();
    assert_eq!(first["items"][0]["id"], DISAPPEARED);
    assert_eq!(second["items"][0]["id"], APPEARED);
    assert_eq!(second["next_cursor"], Value::Null);
    service.stop().await;
}

#[tokio::test]
async fn decisions_need_the_current_etag_and_are_recorded() {
    let service = changed_hall::start().await;
    let read = service.get(&path(APPEARED)).await;
    let tag = read.header("etag").unwrap().to_owned();
    assert_eq!(tag, "\"1\"");
    let said = json!({"note": "I go and look", "by": "J. Kovács"});
    let taken_up = decide(&service, "acknowledge", &tag, said).await;
    assert_eq!(taken_up.status, 200);
    let alert = taken_up.json();
    assert_eq!(
        (&alert["status"], &alert["revision"]),
        (&json!("acknowledged"), &json!(2))
    );
    assert_eq!(alert["actions"], json!(["accept", "dismiss", "reopen"]));
    let entry = &alert["history"][1];
    assert_eq!(
        (&entry["by"], &entry["note"]),
        (&json!("J. Kovács"), &json!("I go and look"))
    );
    assert_eq!(service.get(&path(APPEARED)).await.json(), alert);

    let late = decide(&service, "dismiss", &tag, json!({})).await;
    assert_eq!(
        (late.status, late.problem().as_str()),
        (412, "precondition-failed")
    );
    let twice = decide(&service, "acknowledge", "\"2\"", json!({})).await;
    assert_eq!(
        (twice.status, twice.problem().as_str()),
        (409, "transition-not-allowed")
    );
    let detail = twice.json()["detail"].as_str().unwrap().to_owned();
    assert!(
        detail.ends_with("what is possible now: accept, dismiss, reopen"),
        "{detail}"
    );

    let dismissed = Request::new("POST", format!("{}/dismiss", path(APPEARED)));
    let dismissed = service.send(dismissed.header("if-match", "*")).await;
    assert_eq!(dismissed.json()["status"], "dismissed");
    assert_eq!(dismissed.json()["history"][2]["by"], "anonymous");
    let route = service.get("/v1/routes/hall").await.json();
    assert_eq!(route["counts"]["open_alerts"], 0);
    let reopened = decide(&service, "reopen", "W/\"2\", \"3\"", json!({"note": ""})).await;
    assert_eq!(reopened.json()["status"], "open");
    assert_eq!(reopened.json()["history"][3]["note"], Value::Null);
    assert_eq!(reopened.header("etag"), Some("\"4\""));
    service.stop().await;
}

#[tokio::test]
async fn several_alerts_are_decided_in_one_request() {
    let service = changed_hall::start().await;
    let decide = |decisions: Value| {
        let body = json!({"decisions": decisions, "by": "kim"});
        let request = Request::new("POST", "/v1/alerts/decisions").json(&body);
        service.send(request)
    };
    let results = |answer: &Value| -> Vec<String> {
        let items = answer["items"].as_array().unwrap().iter();
        items
            .map(|item| item["result"].as_str().unwrap().to_owned())
            .collect()
    };
    let nobody = "00000000-0000-7000-8000-00000000ffff";
    let dismiss = json!([
        {"id": APPEARED, "action": "dismiss", "if_match": "\"1\"", "reason": "people"},
        {"id": DISAPPEARED, "action": "accept", "if_match": 1},
        {"id": nobody, "action": "dismiss", "if_match": "*"},
    ]);
    let answer = decide(dismiss.clone()).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    assert_eq!(results(&answer.json()), ["done", "not_allowed", "unknown"]);
    let first = &answer.json()["items"][0];
    assert_eq!(first["alert"]["decision_revision"], 2);
    assert_eq!(first["alert"]["history"][1]["reason"], "people");
    assert_eq!(first["alert"]["history"][1]["by"], "kim");
    let again = decide(dismiss).await.json();
    assert_eq!(results(&again), ["already_done", "not_allowed", "unknown"]);
    let late = json!([{"id": APPEARED, "action": "reopen", "if_match": "\"1\""}]);
    let late = decide(late).await.json();
    assert_eq!(results(&late), ["changed"]);
    let problem = &late["items"][0]["problem"];
    assert_eq!(problem["type"], "/problems/precondition-failed");
    let detail = problem["detail"].as_str().unwrap();
    assert!(
        detail.contains("it is dismissed") && detail.contains("by kim"),
        "{detail}"
    );
    for (decisions, pointer) in [
        (json!([]), "/decisions"),
        (json!([late_of(APPEARED), late_of(APPEARED)]), "/decisions"),
        (
            json!([{"id": APPEARED, "action": "reopen", "if_match": "*", "reason": "people"}]),
            "/decisions/0/reason",
        ),
    ] {
        let refused = decide(decisions).await;
        assert_eq!(refused.status, 422, "{}", refused.text());
        assert_eq!(refused.json()["errors"][0]["pointer"], pointer);
    }
    service.stop().await;
}

fn late_of(id: &str) -> Value {
    json!({"id": id, "action": "reopen", "if_match": "*"})
}

#[tokio::test]
async fn an_acceptance_and_its_undo_each_begin_a_version() {
    let service = changed_hall::start().await;
    let evidence_before = service
        .get(&format!("{}/evidence", path(APPEARED)))
        .await
        .json();
    let accepted = decide(&service, "accept", "\"1\"", json!({"note": "new rack"})).await;
    assert_eq!(accepted.status, 200, "{}", accepted.text());
    assert_eq!(accepted.json()["status"], "accepted");
    assert_eq!(accepted.json()["actions"], json!(["undo"]));
    let edge = service.get("/v1/routes/hall/edges/3").await.json();
    assert_eq!(edge["status"], "retired");
    let route = service.get("/v1/routes/hall").await.json();
    assert_eq!(
        (&route["map_version"], &route["counts"]["open_alerts"]),
        (&json!(2), &json!(0))
    );
    // What it was decided on can still be looked at.
    let evidence = service
        .get(&format!("{}/evidence", path(APPEARED)))
        .await
        .json();
    assert_eq!(
        evidence["residuals"]["entries"],
        evidence_before["residuals"]["entries"]
    );
    assert_eq!(evidence["edge_id"], 3);

    let undone = decide(&service, "undo", "\"2\"", json!({})).await;
    assert_eq!(undone.status, 200, "{}", undone.text());
    assert_eq!(undone.json()["status"], "open");
    let edge = service.get("/v1/routes/hall/edges/3").await.json();
    assert_eq!(edge["status"], "active");
    let route = service.get("/v1/routes/hall").await.json();
    assert_eq!(route["map_version"], 3);
    service.stop().await;
}

#[tokio::test]
async fn several_acceptances_make_one_operation_and_one_version() {
    let service = changed_hall::start().await;
    let reopen = Request::new("POST", format!("{}/reopen", path(DISAPPEARED)));
    let reopened = service.send(reopen.header("if-match", "\"1\"")).await;
    assert_eq!(reopened.status, 200, "{}", reopened.text());
    let nobody = "00000000-0000-7000-8000-00000000ffff";
    let accept = |id: &str| json!({"id": id, "action": "accept", "if_match": "*", "note": "so"});
    let body =
        json!({"decisions": [accept(APPEARED), accept(nobody), accept(DISAPPEARED)], "by": "kim"});
    for expected in [
        [
            ("done", json!(2)),
            ("unknown", json!(null)),
            ("done", json!(2)),
        ],
        [
            ("already_done", json!(null)),
            ("unknown", json!(null)),
            ("already_done", json!(null)),
        ],
    ] {
        let request = Request::new("POST", "/v1/alerts/decisions").json(&body);
        let answer = service.send(request).await;
        assert_eq!(answer.status, 202, "{}", answer.text());
        let operation = ended_operation(&service, answer.header("location").unwrap()).await;
        assert_eq!(operation["kind"], "decisions");
        assert_eq!(operation["route_id"], "hall");
        assert_eq!(operation["status"], "succeeded", "{operation}");
        assert_eq!(operation["progress"], 1.0);
        let outcomes = operation["result"]["decisions"].as_array().unwrap();
        for (outcome, (result, map_version)) in outcomes.iter().zip(expected) {
            assert_eq!(
                (&outcome["result"], &outcome["map_version"]),
                (&json!(result), &map_version)
            );
        }
        let problem = &outcomes[1]["problem"]["type"];
        assert_eq!(problem, "/problems/not-found");
    }
    let route = service.get("/v1/routes/hall").await.json();
    assert_eq!(route["map_version"], 2);
    let accepted = service.get(&path(APPEARED)).await.json();
    let last = &accepted["history"][1];
    assert_eq!((&last["by"], &last["note"]), (&json!("kim"), &json!("so")));
    service.stop().await;
}

/// Half of it had been carried out when the service stopped.
#[tokio::test]
async fn an_operation_is_resumed_after_a_restart() {
    let service = changed_hall::start().await;
    let reopen = Request::new("POST", format!("{}/reopen", path(DISAPPEARED)));
    service.send(reopen.header("if-match", "\"1\"")).await;
    let accepted = decide(&service, "accept", "\"1\"", json!({})).await;
    assert_eq!(accepted.status, 200);
    let directory = service.stop_keeping().await;
    let data_dir = directory.path().join("data");
    let store = Store::open(StoreOptions { data_dir }).await.unwrap();
    let id = OperationId(uuid::Uuid::now_v7());
    let accept = |alert: &str| DecisionRequest {
        alert_id: alert.parse().unwrap(),
        action: AlertAction::Accept,
        decision_revisions: None,
        note: None,
        reason: None,
    };
    let decisions = OperationRequest::Decisions(DecisionsRequest {
        decisions: vec![accept(APPEARED), accept(DISAPPEARED)],
        by: "kim".to_owned(),
        actor: Actor::System,
        routes: None,
    });
    let now = jiff::Timestamp::now();
    let asked = store
        .ask_for(id, None, decisions, &Actor::System, now)
        .await;
    asked.unwrap();
    store.close().await.unwrap();
    let service = Service::start_in(directory, Limits::default()).await;
    let operation = ended_operation(&service, &format!("/v1/operations/{id}")).await;
    let outcomes = operation["result"]["decisions"].as_array().unwrap();
    let results: Vec<&Value> = outcomes.iter().map(|one| &one["result"]).collect();
    assert_eq!(results, ["already_done", "done"]);
    service.stop().await;
}

/// Waits for an operation's end.
async fn ended_operation(service: &Service, path: &str) -> Value {
    let ended = async {
        loop {
            let operation = service.get(path).await.json();
            if operation["status"] != "queued" {
                return operation;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    let ended = tokio::time::timeout(Duration::from_secs(30), ended).await;
    ended.expect("the operation ends")
}

#[tokio::test]
async fn a_preview_changes_nothing_and_explains_its_refusals() {
    let service = changed_hall::start().await;
    let before = service.get("/v1/routes/hall").await.json();
    let preview = service.get(&format!("{}/preview", path(APPEARED))).await;
    assert_eq!(preview.status, 200, "{}", preview.text());
    let preview = preview.json();
    assert_eq!(preview["map_version_next"], 2);
    assert_eq!(
        (&preview["edges_retired"], &preview["edge_ids"]),
        (&json!(1), &json!([3]))
    );
    assert_eq!(
        preview["region"],
        service.get(&path(APPEARED)).await.json()["region"]
    );
    assert_eq!(service.get("/v1/routes/hall").await.json(), before);
    let resolved = service.get(&format!("{}/preview", path(DISAPPEARED))).await;
    assert_eq!(
        (resolved.status, resolved.problem()),
        (409, "transition-not-allowed".to_owned())
    );
    let detail = resolved.json()["detail"].to_string();
    assert!(detail.contains("that is resolved"), "{detail}");
    service.stop().await;
}

/// What the map shows waits for people: it changes when a change is accepted, and not before.
#[tokio::test]
async fn only_an_acceptance_changes_the_map() {
    let service = changed_hall::start().await;
    let map = async || service.get("/v1/routes/hall/map.pgm").await.body;
    let pending = map().await;
    let observed = service.get("/v1/routes/hall/map.pgm?layer=observed").await;
    assert!(observed.body != pending, "a pending change is left out");
    let taken = |step: Answer| assert_eq!(step.status, 200, "{}", step.text());
    taken(decide(&service, "acknowledge", "*", json!({})).await);
    assert!(map().await == pending, "an acknowledgement changes nothing");
    taken(decide(&service, "dismiss", "*", json!({})).await);
    assert!(map().await == pending, "a dismissal changes nothing");
    taken(decide(&service, "reopen", "*", json!({})).await);
    taken(decide(&service, "accept", "*", json!({})).await);
    assert!(map().await != pending, "an acceptance changes the map");
    let first = service.get("/v1/routes/hall/versions/1/map.pgm").await;
    assert!(first.body == pending, "and the version before stays");
    taken(decide(&service, "undo", "*", json!({})).await);
    assert!(
        map().await == pending,
        "an undo brings the first bytes back"
    );
    service.stop().await;
}
