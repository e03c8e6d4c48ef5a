//! Keys of a service, and how they are made, listed and revoked.

use jiff::{SignedDuration, Timestamp};
use mapshift::ids::{KeyId, RouteId, VehicleId};
use mapshift::model::{Actor, Role};
use mapshift::store::{KeyText, NewKey, Secret, Store, StoreOptions};
use serde_json::{Value, json};
use tempfile::TempDir;
use uuid::Uuid;

use crate::changed_hall::{self, APPEARED};
use crate::client::{Answer, Request};
use crate::service::Service;

/// A key for everything that a role may do.
pub fn key(name: &str, role: Role) -> NewKey {
    NewKey {
        id: KeyId(Uuid::now_v7()),
        secret: Secret::random().unwrap(),
        name: name.to_owned(),
        role,
        vehicle_id: None,
        routes: None,
        created_at: Timestamp::now(),
        expires_at: None,
    }
}

/// A key that uploads for one vehicle.
pub fn vehicle_key(vehicle: &str) -> NewKey {
    NewKey {
        vehicle_id: Some(VehicleId::new(vehicle).unwrap()),
        ..key(vehicle, Role::Vehicle)
    }
}

/// A key that is limited to a route.
pub fn limited_key(name: &str, role: Role, route: &str) -> NewKey {
    NewKey {
        routes: Some(vec![RouteId::new(route).unwrap()]),
        ..key(name, role)
    }
}

/// A key that was valid until a minute ago.
pub fn expired_key() -> NewKey {
    let minute = SignedDuration::from_mins(1);
    NewKey {
        expires_at: Some(Timestamp::now() - minute),
        ..key("expired", Role::Admin)
    }
}

/// What the holder of a key sends.
pub fn text(key: &NewKey) -> String {
    let (id, secret) = (key.id, key.secret.clone());
    KeyText { id, secret }.text()
}

/// The store of a directory that no service holds.
pub async fn store(directory: &TempDir) -> Store {
    let data_dir = directory.path().join("data");
    Store::open(StoreOptions { data_dir }).await.unwrap()
}

/// Makes keys, as the command does while no service runs.
pub async fn make(directory: &TempDir, keys: &[&NewKey]) {
    let store = store(directory).await;
    for key in keys {
        let key = (*key).clone();
        store.create_key(key, &Actor::System).await.unwrap();
    }
    store.close().await.unwrap();
}

pub fn with_key(request: Request, key: &NewKey) -> Request {
    request.header("authorization", &format!("Bearer {}", text(key)))
}

pub async fn get(service: &Service, path: &str, key: &NewKey) -> Answer {
    service.send(with_key(Request::new("GET", path), key)).await
}

fn ids(page: &Value) -> Vec<String> {
    let id = |item: &Value| item["id"].as_str().unwrap().to_owned();
    page["items"].as_array().unwrap().iter().map(id).collect()
}

#[tokio::test]
async fn the_first_key_closes_the_service_and_creates_others() {
    let service = Service::start().await;
    service.put_route("hall").await;
    let make = |body: Value| Request::new("POST", "/v1/keys").json(&body);
    let vehicle = json!({"name": "agv-07", "role": "vehicle", "vehicle_id": "agv-07"});
    let refused = service.send(make(vehicle.clone())).await;
    assert_eq!(
        (refused.status, refused.problem().as_str()),
        (409, "first-key")
    );
    let made = service
        .send(make(json!({"name": "Kim", "role": "admin"})))
        .await;
    assert_eq!(made.status, 201);
    assert_eq!(made.header("cache-control"), Some("no-store"));
    let admin = format!("Bearer {}", made.json()["key"].as_str().unwrap());
    assert_eq!(service.get("/v1/routes").await.status, 401);

    let as_admin = |request: Request| request.header("authorization", &admin);
    let made = service.send(as_admin(make(vehicle))).await.json();
    assert_eq!(made["created_by"], "Kim");
    let path = format!("/v1/keys/{}", made["id"].as_str().unwrap());
    let read = service
        .send(as_admin(Request::new("GET", path.as_str())))
        .await
        .json();
    assert_eq!(
        (&read["key"], &read["vehicle_id"]),
        (&Value::Null, &json!("agv-07"))
    );
    let list = Request::new("GET", "/v1/keys");
    assert_eq!(
        ids(&service.send(as_admin(list.clone())).await.json()).len(),
        2
    );

    for _ in 0..2 {
        let revoke = as_admin(Request::new("DELETE", path.as_str()));
        assert_eq!(service.send(revoke).await.status, 204);
    }
    let read = service
        .send(as_admin(Request::new("GET", path)))
        .await
        .json();
    assert!(read["revoked_at"].is_string());
    let vehicle = format!("Bearer {}", made["key"].as_str().unwrap());
    let batches = Request::new("GET", "/v1/routes/hall/batches");
    assert_eq!(
        service
            .send(batches.header("authorization", &vehicle))
            .await
            .status,
        401
    );

    let audit = service
        .send(as_admin(Request::new("GET", "/v1/audit")))
        .await;
    let entries = audit.json()["items"].clone();
    let actions: Vec<_> = entries
        .as_array()
        .unwrap()
        .iter()
        .map(|e| &e["action"])
        .collect();
    let expected = ["key.revoked", "key.created", "key.created", "route.created"];
    assert_eq!(actions, expected);
    assert_eq!(
        (&entries[0]["actor"], &entries[2]["actor"]),
        (&json!("Kim"), &json!("local"))
    );
    assert!(entries[0]["key_id"].is_string() && entries[2]["key_id"].is_null());
    service.stop().await;
}

#[tokio::test]
async fn contradictory_keys_are_refused() {
    let service = Service::start().await;
    for (body, pointer) in [
        (json!({"name": "", "role": "admin"}), "/name"),
        (json!({"name": "System", "role": "admin"}), "/name"),
        (
            json!({"name": "a", "role": "viewer", "vehicle_id": "v"}),
            "/vehicle_id",
        ),
        (
            json!({"name": "a", "role": "viewer", "routes": []}),
            "/routes",
        ),
        (
            json!({"name": "a", "role": "admin", "routes": ["hall"]}),
            "/routes",
        ),
        (
            json!({"name": "a", "role": "admin", "expires_at": "2020-01-01T00:00:00Z"}),
            "/expires_at",
        ),
    ] {
        let answer = service
            .send(Request::new("POST", "/v1/keys").json(&body))
            .await;
        assert_eq!(answer.status, 422, "{body}");
        assert_eq!(answer.json()["errors"][0]["pointer"], pointer);
    }
    let bad = json!({"name": "a", "role": "root"});
    let answer = service
        .send(Request::new("POST", "/v1/keys").json(&bad))
        .await;
    assert_eq!(answer.status, 400);
    service.stop().await;
}

#[tokio::test]
async fn decisions_have_the_name_of_the_signed_in_person() {
    let directory = changed_hall::directory().await;
    let (kim, viewer) = (key("Kim", Role::Maintainer), key("Viewer", Role::Viewer));
    make(&directory, &[&kim, &viewer]).await;
    let service = Service::start_changed(directory, |_| ()).await;
    let decision = json!({"by": "somebody else", "note": "a parked lorry"});
    let dismissal = Request::new("POST", format!("/v1/alerts/{APPEARED}/dismiss"));
    let dismissal = dismissal.header("if-match", "\"1\"").json(&decision);
    let refused = service.send(with_key(dismissal.clone(), &viewer)).await;
    assert_eq!(refused.status, 403);
    let detail = refused.json()["detail"].as_str().unwrap().to_owned();
    assert!(detail.contains("maintainer or admin"), "{detail}");
    let alert = service.send(with_key(dismissal, &kim)).await.json();
    assert_eq!(
        alert["history"].as_array().unwrap().last().unwrap()["by"],
        "Kim"
    );
    let audit = get(&service, "/v1/audit", &kim).await.json();
    assert_eq!(audit["items"][0]["actor"], "Kim");
    assert_eq!(audit["items"][0]["key_id"], kim.id.to_string());
    let table = get(&service, "/v1/audit.csv?action=alert.dismissed", &kim).await;
    assert_eq!(
        table.header("content-type"),
        Some("text/csv; charset=utf-8")
    );
    let lines: Vec<String> = table.text().lines().map(str::to_owned).collect();
    assert_eq!(lines.len(), 2);
    assert!(lines[1].contains(&format!(",Kim,{},127.0.0.1,alert.dismissed,hall,", kim.id)));
    service.stop().await;
}

#[tokio::test]
async fn lists_are_limited_to_the_routes_of_the_key() {
    let directory = changed_hall::directory().await;
    let all = key("all", Role::Maintainer);
    let hall = limited_key("hall", Role::Maintainer, "hall");
    let yard = limited_key("yard", Role::Maintainer, "yard");
    make(&directory, &[&all, &hall, &yard]).await;
    let service = Service::start_changed(directory, |_| ()).await;
    let count = async |path: &str, key: &NewKey| {
        let answer = get(&service, path, key).await;
        assert_eq!(answer.status, 200, "{path}");
        answer.json()["items"].as_array().unwrap().len()
    };
    for (path, counts) in [
        ("/v1/routes", [2, 1, 1]),
        ("/v1/alerts", [2, 2, 0]),
        // The changes of both routes, and three keys.
        ("/v1/audit", [5, 1, 1]),
        ("/v1/webhooks", [0, 0, 0]),
    ] {
        let found = [
            count(path, &all).await,
            count(path, &hall).await,
            count(path, &yard).await,
        ];
        assert_eq!(found, counts, "{path}");
    }
    let features = get(&service, "/v1/alerts.geojson", &yard).await.json();
    assert_eq!(features["features"], json!([]));
    for path in [
        "/v1/alerts?route_id=",
        "/v1/alerts.geojson?route_id=",
        "/v1/alerts/stream?route_id=",
    ] {
        let foreign = get(&service, &format!("{path}hall"), &yard).await;
        let missing = get(&service, &format!("{path}nowhere"), &yard).await;
        assert_eq!(
            (foreign.status, foreign.problem()),
            (404, missing.problem())
        );
        assert_eq!(foreign.json()["detail"], missing.json()["detail"]);
    }
    let decision = json!({"decisions": [{"id": APPEARED, "action": "dismiss", "if_match": 1}]});
    let decide = Request::new("POST", "/v1/alerts/decisions").json(&decision);
    let items = service.send(with_key(decide, &yard)).await.json()["items"].clone();
    assert_eq!(
        (&items[0]["result"], &items[0]["alert"]),
        (&json!("unknown"), &Value::Null)
    );
    let alert = get(&service, &format!("/v1/alerts/{APPEARED}"), &hall).await;
    assert_eq!(alert.json()["status"], "open");
    let no_text = get(&service, "/v1/routes/%ff", &yard).await;
    assert_eq!(
        (no_text.status, no_text.problem().as_str()),
        (400, "invalid-field")
    );
    service.stop().await;
}

#[tokio::test]
async fn a_vehicle_lists_its_own_batches() {
    let directory = changed_hall::directory().await;
    let (own, other) = (vehicle_key("agv-07"), vehicle_key("agv-08"));
    make(&directory, &[&own, &other]).await;
    let service = Service::start_changed(directory, |_| ()).await;
    let batches = "/v1/routes/hall/batches";
    for (path, key, count) in [
        (batches.to_owned(), &own, 1),
        (batches.to_owned(), &other, 0),
        (format!("{batches}?vehicle_id=agv-07"), &other, 0),
    ] {
        let page = get(&service, &path, key).await.json();
        assert_eq!(ids(&page).len(), count, "{path}");
    }
    service.stop().await;
}
