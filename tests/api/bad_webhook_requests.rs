//! What bad requests about webhooks get: one table, sent over real sockets and printed.

use serde_json::{Value, json};

use crate::bad_requests::{Case, case, check};
use crate::client::Request;
use crate::service::Service;
use crate::webhooks::{WEBHOOKS, change, path, register};

const UNKNOWN: &str = "/v1/webhooks/019aa000-0000-7000-8000-00000000ffff";

fn post(body: Value) -> Request {
    Request::new("POST", WEBHOOKS).json(&body)
}

fn registrations() -> Vec<Case> {
    let good = "https://example.com/";
    let raw = Request::new("POST", WEBHOOKS).header("content-type", "application/json");
    let with = |name, field: &str, value: Value, status, problem, pointer| {
        let mut body = json!({"url": good});
        body[field] = value;
        case(name, post(body), status, problem, pointer)
    };
    vec![
        case(
            "broken JSON",
            raw.clone().body("{"),
            400,
            "malformed-json",
            "",
        ),
        case("array", raw.clone().body("[]"), 400, "invalid-field", ""),
        case("no body", raw, 400, "invalid-field", ""),
        case(
            "no URL",
            post(json!({"events": ["alert.raised"]})),
            400,
            "invalid-field",
            "",
        ),
        case(
            "form",
            Request::new("POST", WEBHOOKS)
                .header("content-type", "application/x-www-form-urlencoded")
                .body("url=x"),
            415,
            "unsupported-media-type",
            "",
        ),
        with(
            "URL that is a number",
            "url",
            json!(7),
            400,
            "invalid-field",
            "/url",
        ),
        with(
            "unknown field",
            "secret",
            json!("mine"),
            400,
            "malformed-json",
            "/secret",
        ),
        with(
            "unknown event",
            "events",
            json!(["alert.raised", "alert.closed"]),
            400,
            "invalid-field",
            "/events/1",
        ),
        with(
            "tests as an event",
            "events",
            json!(["webhook.test"]),
            400,
            "invalid-field",
            "/events/0",
        ),
        with(
            "event that is no list",
            "events",
            json!("alert.raised"),
            400,
            "invalid-field",
            "/events",
        ),
        with(
            "no event",
            "events",
            json!([]),
            422,
            "out-of-range",
            "/events",
        ),
        with(
            "route with a slash",
            "route_id",
            json!("a/b"),
            400,
            "invalid-field",
            "/route_id",
        ),
        with(
            "unknown route",
            "route_id",
            json!("nowhere"),
            404,
            "unknown-route",
            "/route_id",
        ),
        with(
            "long description",
            "description",
            json!("x".repeat(201)),
            422,
            "out-of-range",
            "/description",
        ),
        with(
            "description with a line break",
            "description",
            json!("a\nb"),
            422,
            "out-of-range",
            "/description",
        ),
        with(
            "URL of 2,049 bytes",
            "url",
            json!(format!("{good}{:x<2029}", "")),
            422,
            "webhook-url-refused",
            "/url",
        ),
        with(
            "half a URL",
            "url",
            json!("example.com/hook"),
            422,
            "webhook-url-refused",
            "/url",
        ),
        with(
            "http",
            "url",
            json!("http://example.com/"),
            422,
            "webhook-url-refused",
            "/url",
        ),
        with(
            "credentials",
            "url",
            json!("https://a:b@example.com/"),
            422,
            "webhook-url-refused",
            "/url",
        ),
        with(
            "loopback",
            "url",
            json!("https://127.0.0.1/"),
            422,
            "webhook-url-refused",
            "/url",
        ),
        with(
            "a name of this machine",
            "url",
            json!("https://localhost/"),
            422,
            "webhook-url-refused",
            "/url",
        ),
        with(
            "private network",
            "url",
            json!("https://192.168.4.2/"),
            422,
            "webhook-url-refused",
            "/url",
        ),
        with(
            "keys of a cloud",
            "url",
            json!("https://169.254.169.254/"),
            422,
            "webhook-url-refused",
            "/url",
        ),
        with(
            "mapped address",
            "url",
            json!("https://[::ffff:10.0.0.1]/"),
            422,
            "webhook-url-refused",
            "/url",
        ),
    ]
}

fn paths() -> Vec<Case> {
    let test = |path: &str| Request::new("POST", format!("{path}/test"));
    let get = |path: &str| Request::new("GET", path);
    vec![
        case("unknown webhook", get(UNKNOWN), 404, "not-found", ""),
        case(
            "deliveries of an unknown webhook",
            get(&format!("{UNKNOWN}/deliveries")),
            404,
            "not-found",
            "",
        ),
        case(
            "test of an unknown webhook",
            test(UNKNOWN),
            404,
            "not-found",
            "",
        ),
        case(
            "deletion of an unknown webhook",
            Request::new("DELETE", UNKNOWN),
            404,
            "not-found",
            "",
        ),
        case(
            "change of an unknown webhook",
            Request::new("PATCH", UNKNOWN).json(&json!({})),
            404,
            "not-found",
            "",
        ),
        case(
            "id that is no UUID",
            get("/v1/webhooks/7"),
            400,
            "invalid-field",
            "",
        ),
        case(
            "test read",
            get(&format!("{UNKNOWN}/test")),
            405,
            "method-not-allowed",
            "",
        ),
        case(
            "webhook put",
            Request::new("PUT", UNKNOWN).json(&json!({})),
            405,
            "method-not-allowed",
            "",
        ),
        case(
            "limit 0",
            get("/v1/webhooks?limit=0"),
            400,
            "invalid-parameter",
            "limit",
        ),
        case(
            "cursor of nothing",
            get("/v1/webhooks?cursor=zz"),
            400,
            "invalid-parameter",
            "cursor",
        ),
        case(
            "unknown parameter",
            get("/v1/webhooks?route_id=hall"),
            400,
            "invalid-parameter",
            "",
        ),
    ]
}

fn changes(webhook: &Value) -> Vec<Case> {
    let path = path(webhook);
    let patch = |body: Value| Request::new("PATCH", &*path).json(&body);
    let deliveries = |query: &str| Request::new("GET", format!("{path}/deliveries?{query}"));
    vec![
        case(
            "older revision",
            patch(json!({})).header("if-match", "\"0\""),
            412,
            "precondition-failed",
            "If-Match",
        ),
        case(
            "another route",
            patch(json!({"route_id": "hall"})),
            400,
            "malformed-json",
            "/route_id",
        ),
        case(
            "loopback later",
            patch(json!({"url": "https://[::1]/"})),
            422,
            "webhook-url-refused",
            "/url",
        ),
        case(
            "no event any more",
            patch(json!({"events": []})),
            422,
            "out-of-range",
            "/events",
        ),
        case(
            "active by word",
            patch(json!({"active": "yes"})),
            400,
            "invalid-field",
            "/active",
        ),
        case(
            "cursor of another list",
            deliveries("cursor=68616c6c"),
            400,
            "invalid-parameter",
            "cursor",
        ),
        case(
            "deliveries by status",
            deliveries("status=failed"),
            400,
            "invalid-parameter",
            "",
        ),
    ]
}

#[tokio::test]
async fn bad_requests_about_webhooks_get_the_answers_of_the_contract() {
    let service = Service::start().await;
    let webhook = register(&service, json!({"url": "https://example.com/"})).await;
    let cases = [registrations(), paths(), changes(&webhook)];
    check(&service, cases.into_iter().flatten()).await;
    let listed = service.get(WEBHOOKS).await.json();
    assert_eq!(listed["items"].as_array().unwrap().len(), 1);
    assert_eq!(listed["items"][0]["updated_at"], webhook["updated_at"]);
    let disabled = change(&service, &webhook, "*", json!({"active": false})).await;
    assert_eq!(disabled.status, 200);
    let test = Request::new("POST", format!("{}/test", path(&webhook)));
    let refused = case(
        "test of a disabled webhook",
        test,
        409,
        "webhook-disabled",
        "",
    );
    check(&service, [refused]).await;
    service.stop().await;
}
