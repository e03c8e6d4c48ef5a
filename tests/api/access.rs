//! Every operation of the OpenAPI document, asked for by everybody: who may, written down once more.

use mapshift::model::Role;
use mapshift::store::NewKey;
use serde_json::{Value, json};

use crate::body;
use crate::changed_hall::{self, APPEARED};
use crate::client::{Answer, Request};
use crate::keys::{expired_key, key, limited_key, make, store, vehicle_key, with_key};
use crate::service::Service;

/// For each operation, what becomes of it if it is asked for by: nobody, the vehicle whose batch it
/// is, another vehicle, a viewer, a maintainer, an admin, a maintainer limited to the route that it is
/// about, one limited to another. `+` it passes, `a` 401, `f` 403, `-` 404 as if it were not there.
const EXPECTED: [(&str, &[&str]); 13] = [
    (
        "++++++++",
        &["livez", "readyz", "get_session", "sign_in", "sign_out"],
    ),
    ("aff+++ff", &["metrics"]),
    (
        "affff+ff",
        &[
            "list_keys",
            "create_key",
            "get_key",
            "revoke_key",
            "delete_route",
            "register_webhook",
            "change_webhook",
            "delete_webhook",
            "test_webhook",
            "rotate_webhook_secret",
        ],
    ),
    (
        "afff++++",
        &[
            "list_audit",
            "export_audit",
            "decide_alerts",
            "list_webhooks",
        ],
    ),
    (
        "aff+++++",
        &[
            "list_routes",
            "list_alerts",
            "list_alerts_geojson",
            "stream_alerts",
            "get_report",
        ],
    ),
    (
        "a+ff+++-",
        &["put_batch", "put_edge_batch", "put_recording"],
    ),
    ("a+-++++-", &["get_batch", "get_node", "get_trajectory"]),
    ("a++++++-", &["list_batches"]),
    (
        "afff+++-",
        &[
            "put_route",
            "retry_batch",
            "release_version",
            "retire_version",
            "post_removal",
            "quarantine_vehicle",
            "release_vehicle",
        ],
    ),
    (
        "afff+++-",
        &[
            "acknowledge_alert",
            "accept_alert",
            "dismiss_alert",
            "reopen_alert",
            "undo_alert",
            "assign_alert",
            "comment_on_alert",
            "create_zone",
            "put_zone",
            "delete_zone",
        ],
    ),
    ("afff+++-", &["get_webhook", "list_deliveries"]),
    (
        "aff++++-",
        &[
            "get_alert",
            "get_evidence",
            "get_evidence_svg",
            "list_alert_passes",
            "list_alert_comments",
            "preview_alert",
            "list_zones",
            "get_zone",
            "get_observations",
            "get_observations_svg",
            "get_operation",
        ],
    ),
    (
        "aff++++-",
        &[
            "get_route",
            "list_vehicles",
            "get_vehicle",
            "get_graph",
            "get_graph_g2o",
            "list_nodes",
            "get_node_scan",
            "list_edges",
            "get_edge",
            "list_subgraphs",
            "get_trajectory_tum",
            "get_residuals",
            "get_map_png",
            "get_map_pgm",
            "get_map_yaml",
            "list_versions",
            "get_version",
            "get_vda5050",
            "get_tiles",
            "get_tile",
            "get_trajectory_layer",
            "get_residual_layer",
            "get_keyframe_layer",
            "list_trips",
            "get_version_diff",
            "get_version_diff_png",
            "get_version_png",
            "get_version_pgm",
            "get_version_yaml",
        ],
    ),
];

fn expected(operation: &str) -> &'static str {
    let mut rows = EXPECTED.iter().filter(|(_, of)| of.contains(&operation));
    let (Some((outcomes, _)), None) = (rows.next(), rows.next()) else {
        panic!("{operation} is not expected once: write down who may");
    };
    outcomes
}

/// The operations: id, method, path.
pub fn operations() -> Vec<(String, &'static str, String)> {
    let document = mapshift::api::openapi_document().unwrap();
    let mut operations = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let method = match method.as_str() {
                "get" => "GET",
                "put" => "PUT",
                "post" => "POST",
                "patch" => "PATCH",
                "delete" => "DELETE",
                other => panic!("{other}"),
            };
            let id = operation["operationId"].as_str().unwrap();
            operations.push((id.to_owned(), method, path.clone()));
        }
    }
    operations
}

/// What is there to be asked for.
struct Things {
    webhook: String,
    operation: String,
    key: String,
}

impl Things {
    async fn make(service: &Service, admin: &NewKey) -> Self {
        let send = async |method, path: &str, body: Value| {
            let answer = service.send(with_key(Request::new(method, path).json(&body), admin));
            answer.await.json()["id"].as_str().unwrap().to_owned()
        };
        let hook = json!({"url": "https://example.com/hook", "route_id": "hall"});
        let removal = json!({"batches": ["b-9"], "dry_run": true});
        Self {
            webhook: send("POST", "/v1/webhooks", hook).await,
            operation: send("POST", "/v1/routes/hall/removals", removal).await,
            key: admin.id.to_string(),
        }
    }

    /// A path with names of things in place of its parameters.
    fn path(&self, template: &str) -> String {
        let mut path = template.to_owned();
        for (parameter, name) in [
            ("{route}", "hall"),
            ("{batch}", "b-0"),
            ("{vehicle}", "agv-07"),
            ("{trip}", "trip-1"),
            ("{node}", "1"),
            ("{edge}", "3"),
            ("{version}", "1"),
            ("{alert}", APPEARED),
            ("{webhook}", &self.webhook),
            ("{operation}", &self.operation),
            ("{key}", &self.key),
            ("{zone}", "0199a000-0000-7000-8000-000000000001"),
            ("{z}", "8"),
            ("{x}", "0"),
            ("{y}", "0.png"),
        ] {
            path = path.replace(parameter, name);
        }
        assert!(!path.contains('{'), "{template} needs a name");
        path
    }
}

/// Uploads and what is read of them are asked for in earnest; everything else with a parameter that
/// no operation takes, so that nothing happens if it passes.
fn request(operation: &str, method: &'static str, path: String) -> Request {
    match operation {
        "put_batch" => Request::new(method, path).json(&body::batch(0, 3)),
        "put_edge_batch" => {
            let edges = json!({
                "vehicle_id": "agv-07",
                "nodes": [{"id": 0, "pose": {"x": 0.0, "y": 0.0, "theta": 0.0}}],
                "edges": [],
            });
            Request::new(method, path.replace("b-0", "e-0")).json(&edges)
        }
        "put_recording" => {
            let query = "vehicle_id=agv-07&trip_id=monday&format=carmen";
            Request::new(method, format!("{path}?{query}"))
                .header("content-type", "application/octet-stream")
                .body("no log")
        }
        "get_batch" | "get_node" | "get_trajectory" => Request::new(method, path),
        _ => Request::new(method, format!("{path}?nonsense=1")),
    }
}

fn outcome(answer: &Answer) -> char {
    match answer.status {
        401 => {
            assert_eq!(answer.header("www-authenticate"), Some("Bearer"));
            'a'
        }
        403 => 'f',
        404 => '-',
        _ => '+',
    }
}

#[tokio::test]
async fn every_role_may_use_exactly_the_listed_operations() {
    let directory = changed_hall::directory().await;
    let admin = key("admin", Role::Admin);
    let revoked = key("revoked", Role::Admin);
    let holders = [
        vehicle_key("agv-07"),
        vehicle_key("agv-08"),
        key("viewer", Role::Viewer),
        key("maintainer", Role::Maintainer),
        admin.clone(),
        limited_key("of hall", Role::Maintainer, "hall"),
        limited_key("of yard", Role::Maintainer, "yard"),
    ];
    let ended = [revoked.clone(), expired_key()];
    let all: Vec<&NewKey> = holders.iter().chain(&ended).collect();
    make(&directory, &all).await;
    let keys = store(&directory).await;
    let now = jiff::Timestamp::now();
    let by = mapshift::model::Actor::System;
    assert!(keys.revoke_key(revoked.id, &by, now).await.unwrap());
    keys.close().await.unwrap();

    let service = Service::start_changed(directory, |_| ()).await;
    let things = Things::make(&service, &admin).await;
    let mut wrong = Vec::new();
    for (operation, method, template) in operations() {
        let asked = request(&operation, method, things.path(&template));
        let mut found = vec![outcome(&service.send(asked.clone()).await)];
        for holder in &holders {
            let answer = service.send(with_key(asked.clone(), holder)).await;
            found.push(outcome(&answer));
        }
        let found = String::from_iter(found);
        if found != expected(&operation) {
            wrong.push(format!(
                "{operation}: {found}, not {}",
                expected(&operation)
            ));
        }
        for key in &ended {
            let answer = service.send(with_key(asked.clone(), key)).await;
            let is_probe = ["livez", "readyz"].contains(&operation.as_str());
            if outcome(&answer) != if is_probe { '+' } else { 'a' } {
                wrong.push(format!(
                    "{operation}: {} with a key that has ended",
                    answer.status
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    let count: usize = EXPECTED.iter().map(|(_, of)| of.len()).sum();
    assert_eq!(operations().len(), count);
    service.stop().await;
}

#[tokio::test]
async fn routes_outside_a_key_s_limits_are_answered_like_missing_ones() {
    let directory = changed_hall::directory().await;
    let (admin, yard) = (
        key("admin", Role::Admin),
        limited_key("yard", Role::Maintainer, "yard"),
    );
    let vehicle = vehicle_key("agv-08");
    make(&directory, &[&admin, &yard, &vehicle]).await;
    let service = Service::start_changed(directory, |_| ()).await;
    let things = Things::make(&service, &admin).await;
    let missing = "019aa000-0000-7000-8000-00000000ffff";
    for (key, foreign, absent) in [
        (
            &yard,
            "/v1/routes/hall".to_owned(),
            "/v1/routes/nowhere".to_owned(),
        ),
        (
            &yard,
            "/v1/routes/hall/nodes/1".into(),
            "/v1/routes/nowhere/nodes/1".into(),
        ),
        (
            &yard,
            format!("/v1/alerts/{APPEARED}"),
            format!("/v1/alerts/{missing}"),
        ),
        (
            &yard,
            format!("/v1/webhooks/{}", things.webhook),
            format!("/v1/webhooks/{missing}"),
        ),
        (
            &yard,
            format!("/v1/operations/{}", things.operation),
            format!("/v1/operations/{missing}"),
        ),
        (
            &vehicle,
            "/v1/routes/hall/batches/b-0".into(),
            "/v1/routes/hall/batches/b-1".into(),
        ),
    ] {
        let ask = async |path: &str| {
            let request = Request::new("GET", path).header("x-request-id", "same");
            service.send(with_key(request, key)).await
        };
        let (foreign, absent) = (ask(&foreign).await, ask(&absent).await);
        assert_eq!((foreign.status, foreign.text()), (404, absent.text()));
        assert_eq!(foreign.headers, absent.headers);
    }
    service.stop().await;
}

#[tokio::test]
async fn the_console_and_the_documents_need_no_key() {
    let directory = changed_hall::directory().await;
    make(&directory, &[&key("admin", Role::Admin)]).await;
    let service = Service::start_changed(directory, |_| ()).await;
    for path in [
        "/",
        "/app.js",
        "/openapi.json",
        "/docs/",
        "/livez",
        "/readyz",
        "/v1/session",
    ] {
        assert_eq!(service.get(path).await.status, 200, "{path}");
    }
    let session = service.get("/v1/session").await.json();
    let nobody =
        json!({"open": false, "name": null, "role": null, "routes": null, "expires_at": null});
    assert_eq!(session, nobody);
    service.stop().await;
}
