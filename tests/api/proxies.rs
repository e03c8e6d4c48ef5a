//! Identities that a proxy states.

use mapshift::api::TrustedProxies;
use serde_json::json;

use crate::changed_hall::{self, APPEARED};
use crate::client::Request;
use crate::service::Service;

/// Behind a proxy at this address.
async fn behind(network: &str) -> Service {
    let directory = changed_hall::directory().await;
    let proxies = TrustedProxies {
        networks: vec![network.parse().unwrap()],
        roles: vec!["keepers=maintainer".parse().unwrap()],
    };
    Service::start_changed(directory, |config| config.access.proxies = proxies).await
}

fn stated(request: Request, groups: &str) -> Request {
    let request = request.header("x-forwarded-user", "Kim");
    request.header("x-forwarded-groups", groups)
}

#[tokio::test]
async fn a_trusted_proxy_identifies_people() {
    let service = behind("127.0.0.0/8").await;
    let session = stated(Request::new("GET", "/v1/session"), "all,keepers");
    let session = service.send(session).await.json();
    let kim = json!({"open": false, "name": "Kim", "role": "maintainer", "routes": null, "expires_at": null});
    assert_eq!(session, kim);
    let dismissal = Request::new("POST", format!("/v1/alerts/{APPEARED}/dismiss"));
    let dismissal = dismissal
        .header("if-match", "\"1\"")
        .json(&json!({"by": "root"}));
    let foreign = dismissal.clone().header("origin", "http://evil.example");
    assert_eq!(service.send(stated(foreign, "keepers")).await.status, 403);
    let alert = service.send(stated(dismissal, "keepers")).await.json();
    assert_eq!(
        alert["history"].as_array().unwrap().last().unwrap()["by"],
        "Kim"
    );
    let audit = stated(Request::new("GET", "/v1/audit"), "keepers");
    let audit = service.send(audit).await.json();
    assert_eq!(
        (&audit["items"][0]["actor"], &audit["items"][0]["key_id"]),
        (&json!("Kim"), &json!(null))
    );

    let routes = || Request::new("GET", "/v1/routes");
    assert_eq!(service.send(stated(routes(), "others")).await.status, 403);
    assert_eq!(service.send(routes()).await.status, 401);
    let twice = stated(routes(), "keepers").header("x-auth-request-user", "root");
    assert_eq!(service.send(twice).await.status, 403);
    service.stop().await;
}

#[tokio::test]
async fn headers_of_untrusted_proxies_are_ignored() {
    let service = behind("192.0.2.0/24").await;
    for request in [
        Request::new("GET", "/v1/routes"),
        Request::new("DELETE", "/v1/routes/hall"),
    ] {
        assert_eq!(service.send(stated(request, "keepers")).await.status, 401);
    }
    service.stop().await;
}
