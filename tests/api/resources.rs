//! The resources as clients see them.

use serde_json::{Value, json};

use crate::body::batch;
use crate::client::Request;
use crate::service::Service;

/// Replaces what differs from run to run.
pub fn steady(mut value: Value) -> Value {
    fn visit(value: &mut Value) {
        match value {
            Value::Object(fields) => {
                for (name, field) in fields {
                    let varies = ["created_at", "updated_at", "received_at", "processed_at"];
                    if varies.contains(&name.as_str()) && field.is_string() {
                        *field = json!("[time]");
                    } else if name == "instance" {
                        *field = json!("[request id]");
                    } else {
                        visit(field);
                    }
                }
            }
            Value::Array(items) => items.iter_mut().for_each(visit),
            _ => {}
        }
    }
    visit(&mut value);
    value
}

#[tokio::test]
async fn a_route_and_its_map_have_the_documented_form() {
    let service = Service::start_with_map().await;
    for (name, path) in [
        ("route", "/v1/routes/hall"),
        ("routes", "/v1/routes"),
        ("batch", "/v1/routes/hall/batches/b-0"),
        (
            "batches",
            "/v1/routes/hall/batches?status=merged&vehicle_id=agv-07",
        ),
        ("graph", "/v1/routes/hall/graph"),
        ("graph_in_a_box", "/v1/routes/hall/graph?bbox=-0.1,-1,0.6,1"),
        ("nodes", "/v1/routes/hall/nodes?limit=2"),
        ("node_scan", "/v1/routes/hall/nodes/2/scan"),
        (
            "loop_closures",
            "/v1/routes/hall/edges?kind=loop_closure&status=active",
        ),
        ("edge", "/v1/routes/hall/edges/1"),
        ("subgraphs", "/v1/routes/hall/subgraphs"),
        ("residuals", "/v1/routes/hall/residuals?subgraph_id=1"),
        (
            "residuals_all_points",
            "/v1/routes/hall/residuals?measurement=all_points",
        ),
        ("trajectory", "/v1/routes/hall/trajectories/trip-1"),
        (
            "trajectory_of_all_scans",
            "/v1/routes/hall/trajectories/trip-1?poses=all",
        ),
        ("versions", "/v1/routes/hall/versions"),
        ("trips", "/v1/routes/hall/trips"),
        ("problem", "/v1/routes/nowhere"),
    ] {
        let answer = service.get(path).await;
        insta::assert_json_snapshot!(name, steady(answer.json()));
    }
    for (name, path) in [
        ("graph_g2o", "/v1/routes/hall/graph.g2o"),
        ("trajectory_tum", "/v1/routes/hall/trajectories/trip-1/tum"),
        (
            "trajectory_tum_of_all_scans",
            "/v1/routes/hall/trajectories/trip-1/tum?poses=all",
        ),
        ("map_yaml", "/v1/routes/hall/map.yaml"),
    ] {
        let answer = service.get(path).await;
        assert_eq!(answer.status, 200);
        insta::assert_snapshot!(name, answer.text());
    }
    service.stop().await;
}

#[tokio::test]
async fn pictures_are_drawn_once_per_etag() {
    let service = Service::start_with_map().await;
    let png = service.get("/v1/routes/hall/map.png").await;
    assert_eq!(png.status, 200);
    assert_eq!(png.header("content-type"), Some("image/png"));
    assert!(png.body.starts_with(b"\x89PNG"));
    let pgm = service.get("/v1/routes/hall/map.pgm").await;
    assert!(pgm.body.starts_with(b"P5\n"));
    let versions = service.get("/v1/routes/hall/versions").await.json();
    assert!(versions["items"][0]["sha256"].is_null(), "it still grows");
    let tag = png.header("etag").unwrap();
    let again = Request::new("GET", "/v1/routes/hall/map.png").header("if-none-match", tag);
    let again = service.send(again).await;
    assert_eq!(again.status, 304);
    assert!(again.body.is_empty());
    service.put_route("empty").await;
    let none = service.get("/v1/routes/empty/map.png").await;
    assert_eq!((none.status, none.problem().as_str()), (404, "not-found"));
    service.stop().await;
}

#[tokio::test]
async fn a_route_is_created_changed_guarded_and_deleted() {
    let service = Service::start().await;
    let path = "/v1/routes/line-4";
    let put = |body: Value| Request::new("PUT", path).json(&body);
    let anchor = json!({"latitude": 47.5, "longitude": 19.0, "heading": 12.0});
    let created = service
        .send(put(json!({"display_name": "Line 4", "geo_anchor": anchor})))
        .await;
    assert_eq!(created.status, 201);
    let changed = service
        .send(put(
            json!({"settings": {"hold_s": 60, "false_alarm_rate": 1, "max_shift_m": 0.1}}),
        ))
        .await;
    assert_eq!(changed.status, 200);
    let changed = service
        .send(put(json!({"settings": {"detector": "seed"}})))
        .await;
    let route = changed.json();
    assert_eq!(route["display_name"], "Line 4");
    assert_eq!(route["geo_anchor"], anchor);
    assert_eq!(
        route["settings"],
        json!({"detector": "seed", "false_alarm_rate": 1.0, "hold_s": 60, "max_shift_m": 0.1})
    );

    let stale = created.header("etag").unwrap();
    let refused = service.send(put(json!({})).header("if-match", stale)).await;
    assert_eq!(
        (refused.status, refused.problem().as_str()),
        (412, "precondition-failed")
    );
    let fresh = changed.header("etag").unwrap();
    assert_eq!(service.get(path).await.header("etag"), Some(fresh));
    let taken = service.send(put(json!({})).header("if-match", fresh)).await;
    assert_eq!(taken.status, 200);

    assert_eq!(service.send(Request::new("DELETE", path)).await.status, 204);
    assert_eq!(service.send(Request::new("DELETE", path)).await.status, 404);
    assert_eq!(service.get(path).await.problem(), "unknown-route");
    service.stop().await;
}

#[tokio::test]
async fn pages_of_a_list_have_no_gaps() {
    let service = Service::start().await;
    for route in ["a", "b", "c", "d", "e"] {
        service.put_route(route).await;
    }
    for k in 0..5 {
        let put = Request::new("PUT", format!("/v1/routes/a/batches/b{k}")).json(&batch(k, 1));
        assert_eq!(service.send(put).await.status, 202);
    }
    for (list, expected) in [
        ("/v1/routes", ["a", "b", "c", "d", "e"]),
        ("/v1/routes/a/batches", ["b0", "b1", "b2", "b3", "b4"]),
    ] {
        let (mut ids, mut cursor) = (Vec::new(), String::new());
        loop {
            let page = service.get(&format!("{list}?limit=2{cursor}")).await.json();
            let items = page["items"].as_array().unwrap();
            ids.extend(
                items
                    .iter()
                    .map(|item| item["id"].as_str().unwrap().to_owned()),
            );
            match page["next_cursor"].as_str() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => break,
            }
        }
        assert_eq!(ids, expected);
    }
    service.stop().await;
}

#[tokio::test]
async fn operations_and_documents_are_served() {
    let service = Service::start().await;
    for path in ["/livez", "/readyz"] {
        assert_eq!(service.get(path).await.text(), "ok\n");
    }
    let metrics = service.get("/metrics").await.text();
    for name in [
        "mapshift_http_requests_total{method=\"GET\",path=\"/livez\",status=\"200\"}",
        "mapshift_http_request_duration_seconds_bucket",
        "mapshift_pending_batches 0",
    ] {
        assert!(metrics.contains(name), "{name} is not in\n{metrics}");
    }
    let document = service.get("/openapi.json").await.json();
    assert_eq!(document["openapi"], "3.1.0");
    for (path, policy) in [
        ("/", "script-src 'self'; style-src 'self';"),
        (
            "/docs/",
            "script-src 'self'; style-src 'self' 'unsafe-inline'",
        ),
    ] {
        let page = service.get(path).await;
        assert_eq!(page.status, 200);
        assert!(
            page.header("content-security-policy")
                .unwrap()
                .contains(policy)
        );
        assert!(
            !page.text().contains("<script>"),
            "{path} has an inline script"
        );
    }
    for path in [
        "/app.js",
        "/map.js",
        "/words.js",
        "/console.css",
        "/docs/swagger-ui-bundle.js",
        "/docs/swagger-initializer.js",
    ] {
        assert_eq!(service.get(path).await.status, 200, "{path}");
    }
    let script = service.get("/app.js").await;
    let known =
        Request::new("GET", "/app.js").header("if-none-match", script.header("etag").unwrap());
    let again = service.send(known).await;
    assert_eq!((again.status, again.text().as_str()), (304, ""));
    let initialiser = service.get("/docs/swagger-initializer.js").await.text();
    assert!(initialiser.contains("/openapi.json"));
    service.stop().await;
}

#[test]
fn the_committed_document_is_the_one_that_is_served() {
    let served = mapshift::api::openapi_document().unwrap();
    let committed: Value =
        serde_json::from_str(include_str!("../../openapi/openapi.json")).unwrap();
    assert!(
        served == committed,
        "openapi/openapi.json is out of date: cargo run -- openapi > openapi/openapi.json"
    );
}
