//! Signing in on the page: cookies, and pages of others that try to use them.

use jiff::{SignedDuration, Timestamp};
use mapshift::model::Role;
use mapshift::store::{NewKey, Secret};
use serde_json::{Value, json};

use crate::changed_hall::{self, APPEARED};
use crate::client::{Answer, Request};
use crate::keys::{key, make, store, text, with_key};
use crate::service::Service;

const OWN: &str = "http://localhost";

async fn sign_in(service: &Service, key: &str) -> Answer {
    let request = Request::new("POST", "/v1/session").header("origin", OWN);
    service.send(request.json(&json!({"key": key}))).await
}

/// The cookie as a browser sends it back.
fn cookie(answer: &Answer) -> String {
    let header = answer.header("set-cookie").unwrap();
    header.split(';').next().unwrap().to_owned()
}

fn acknowledge() -> Request {
    let request = Request::new("POST", format!("/v1/alerts/{APPEARED}/acknowledge"));
    request.header("if-match", "\"9\"").json(&json!({}))
}

async fn hall(keys: &[&NewKey]) -> Service {
    let directory = changed_hall::directory().await;
    make(&directory, keys).await;
    Service::start_changed(directory, |_| ()).await
}

#[tokio::test]
async fn a_key_is_exchanged_for_a_session_that_ends() {
    let kim = key("Kim", Role::Maintainer);
    let service = hall(&[&kim]).await;
    let signed_in = sign_in(&service, &text(&kim)).await;
    assert_eq!(signed_in.status, 200);
    let header = signed_in.header("set-cookie").unwrap();
    assert!(header.contains("; Path=/;") && header.contains("HttpOnly; SameSite=Strict"));
    assert!(!header.contains("Secure"), "{header}");
    let cookie = cookie(&signed_in);
    let get = |path: &str| Request::new("GET", path).header("cookie", &cookie);
    let session = service.send(get("/v1/session")).await.json();
    assert_eq!(
        (&session["name"], &session["role"]),
        (&json!("Kim"), &json!("maintainer"))
    );
    let ends: Timestamp = session["expires_at"].as_str().unwrap().parse().unwrap();
    assert!(ends > Timestamp::now() + SignedDuration::from_hours(7 * 24 - 1));
    assert_eq!(service.send(get("/v1/routes")).await.status, 200);

    let sign_out = Request::new("DELETE", "/v1/session").header("cookie", &cookie);
    let answer = service.send(sign_out.header("origin", OWN)).await;
    assert_eq!(answer.status, 204);
    assert!(answer.header("set-cookie").unwrap().contains("Max-Age=0"));
    assert_eq!(service.send(get("/v1/routes")).await.status, 401);
    let session = service.send(get("/v1/session")).await;
    assert_eq!(
        (session.status, &session.json()["name"]),
        (200, &Value::Null)
    );
    service.stop().await;
}

#[tokio::test]
async fn a_session_ends_with_its_key() {
    let (kim, admin) = (key("Kim", Role::Viewer), key("admin", Role::Admin));
    let service = hall(&[&kim, &admin]).await;
    let cookie = cookie(&sign_in(&service, &text(&kim)).await);
    let get = Request::new("GET", "/v1/routes").header("cookie", &cookie);
    assert_eq!(service.send(get.clone()).await.status, 200);
    let revoke = Request::new("DELETE", format!("/v1/keys/{}", kim.id));
    assert_eq!(service.send(with_key(revoke, &admin)).await.status, 204);
    assert_eq!(service.send(get).await.status, 401);
    assert_eq!(sign_in(&service, &text(&kim)).await.status, 401);
    service.stop().await;
}

#[tokio::test]
async fn an_unused_session_ends() {
    let kim = key("Kim", Role::Viewer);
    let directory = changed_hall::directory().await;
    make(&directory, &[&kim]).await;
    let keys = store(&directory).await;
    let (fresh, idle) = (Secret::random().unwrap(), Secret::random().unwrap());
    let ago = |hours| Timestamp::now() - SignedDuration::from_hours(hours);
    keys.begin_session(&idle, kim.id, ago(13)).await.unwrap();
    keys.begin_session(&fresh, kim.id, ago(11)).await.unwrap();
    keys.close().await.unwrap();
    let service = Service::start_changed(directory, |_| ()).await;
    for (id, status) in [(&fresh, 200), (&idle, 401)] {
        let cookie = format!("mapshift_session={}", id.text());
        let get = Request::new("GET", "/v1/routes").header("cookie", &cookie);
        assert_eq!(service.send(get).await.status, status);
    }
    service.stop().await;
}

#[tokio::test]
async fn pages_of_other_sites_cannot_change_anything() {
    let kim = key("Kim", Role::Maintainer);
    let service = hall(&[&kim]).await;
    let cookie = cookie(&sign_in(&service, &text(&kim)).await);
    let by_cookie = || acknowledge().header("cookie", &cookie);
    for (request, status) in [
        (by_cookie(), 403),
        (by_cookie().header("origin", "http://evil.example"), 403),
        (by_cookie().header("origin", "http://localhost:3000"), 403),
        (by_cookie().header("origin", "null"), 403),
        (by_cookie().header("sec-fetch-site", "cross-site"), 403),
        (by_cookie().header("sec-fetch-site", "same-site"), 403),
        // It passes, and is about another revision.
        (by_cookie().header("origin", OWN), 412),
        (by_cookie().header("sec-fetch-site", "same-origin"), 412),
        (with_key(acknowledge(), &kim), 412),
        (
            with_key(acknowledge(), &kim).header("origin", "http://evil.example"),
            403,
        ),
    ] {
        let answer = service.send(request.clone()).await;
        assert_eq!(answer.status, status, "{:?}", request.headers);
        if status == 403 {
            assert_eq!(answer.problem(), "foreign-origin");
        }
    }
    let sign_in = Request::new("POST", "/v1/session").header("origin", "http://evil.example");
    let answer = service
        .send(sign_in.json(&json!({"key": text(&kim)})))
        .await;
    assert_eq!(answer.status, 403);
    service.stop().await;
}

#[tokio::test]
async fn a_service_without_keys_is_open_only_to_its_own_pages() {
    let service = Service::start().await;
    let open =
        json!({"open": true, "name": null, "role": "admin", "routes": null, "expires_at": null});
    assert_eq!(service.get("/v1/session").await.json(), open);
    let put = || Request::new("PUT", "/v1/routes/hall");
    let foreign = service
        .send(put().header("origin", "http://evil.example"))
        .await;
    assert_eq!(
        (foreign.status, foreign.problem().as_str()),
        (403, "foreign-origin")
    );
    assert_eq!(service.send(put().header("origin", OWN)).await.status, 201);
    assert_eq!(sign_in(&service, "ms_a_b").await.status, 401);
    service.stop().await;
}

#[tokio::test]
async fn a_foreign_host_is_refused() {
    let directory = changed_hall::directory().await;
    let url = "https://maps.example.com".parse().unwrap();
    let service = Service::start_changed(directory, |config| {
        config.access.public_url = Some(url);
    })
    .await;
    let at = async |host: &str, path: &str| {
        let mut connection = crate::client::Connection::open(service.address).await;
        let head = format!("GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n");
        connection.write(head.as_bytes()).await;
        connection.answer().await
    };
    for path in ["/v1/routes", "/", "/openapi.json", "/metrics"] {
        let answer = at("evil.example", path).await;
        assert_eq!(
            (answer.status, answer.problem().as_str()),
            (421, "foreign-host"),
            "{path}"
        );
    }
    for path in ["/livez", "/readyz"] {
        assert_eq!(at("evil.example", path).await.status, 200, "{path}");
    }
    for host in ["127.0.0.1:9", "[::1]", "localhost:8080", "maps.example.com"] {
        assert_eq!(at(host, "/v1/routes").await.status, 200, "{host}");
    }
    // The target says more than the header.
    assert_eq!(
        at("localhost", "http://evil.example/v1/routes")
            .await
            .status,
        421
    );
    assert_eq!(
        at("localhost\r\nhost: evil.example", "/v1/routes")
            .await
            .status,
        421
    );
    service.stop().await;
}

#[tokio::test]
async fn an_address_that_guesses_keys_must_wait() {
    let kim = key("Kim", Role::Viewer);
    let service = hall(&[&kim]).await;
    assert_eq!(sign_in(&service, &text(&kim)).await.status, 200);
    let wrong = text(&key("Kim", Role::Viewer));
    for _ in 0..10 {
        assert_eq!(sign_in(&service, &wrong).await.status, 401);
    }
    for key in [&wrong, &text(&kim)] {
        let answer = sign_in(&service, key).await;
        assert_eq!(
            (answer.status, answer.problem().as_str()),
            (429, "too-many-sign-ins")
        );
        let wait: u32 = answer.header("retry-after").unwrap().parse().unwrap();
        assert!((1..=61).contains(&wait));
    }
    service.stop().await;
}
