//! What bad requests about alerts get: one table, sent over real sockets and printed.

use serde_json::{Value, json};

use crate::bad_requests::{Case, case, check};
use crate::changed_hall::{self, APPEARED, DISAPPEARED};
use crate::client::Request;

const UNKNOWN: &str = "019aa000-0000-7000-8000-00000000ffff";

fn get(path: &str) -> Request {
    Request::new("GET", path)
}

fn post(alert: &str, action: &str) -> Request {
    Request::new("POST", format!("/v1/alerts/{alert}/{action}"))
}

fn decision(body: Value) -> Request {
    let request = post(APPEARED, "acknowledge").header("if-match", "\"1\"");
    request.json(&body)
}

fn lists() -> Vec<Case> {
    let query = |name, query: &str, pointer| {
        let request = get(&format!("/v1/alerts?{query}"));
        case(name, request, 400, "invalid-parameter", pointer)
    };
    vec![
        query("unknown kind", "kind=moved", ""),
        query("unknown status", "status=closed", ""),
        query("unknown tier", "tier=certain", ""),
        query("since that is no time", "since=yesterday", "since"),
        query("since without a zone", "since=2026-11-20T06:00:00", "since"),
        query("box of three numbers", "bbox=1,2,3", "bbox"),
        query("box inside out", "bbox=5,5,1,1", "bbox"),
        query(
            "confidence in percent",
            "min_confidence=95",
            "min_confidence",
        ),
        query(
            "confidence that is no number",
            "min_confidence=nan",
            "min_confidence",
        ),
        query("route with a slash", "route_id=a%2Fb", "route_id"),
        query("limit 0", "limit=0", "limit"),
        query("cursor of another list", "cursor=68616c6c", "cursor"),
        query("parameter that is not there", "vehicle=agv-07", ""),
        case(
            "alerts of an unknown route",
            get("/v1/alerts?route_id=nowhere"),
            404,
            "unknown-route",
            "",
        ),
        case(
            "GeoJSON of a route without an anchor",
            get("/v1/alerts.geojson?route_id=yard"),
            409,
            "no-geo-anchor",
            "route_id",
        ),
        case(
            "GeoJSON of a route at the pole",
            get("/v1/alerts.geojson?route_id=pole"),
            409,
            "no-geo-anchor",
            "route_id",
        ),
        case(
            "stream after something that is no event",
            get("/v1/alerts/stream").header("last-event-id", "abc"),
            400,
            "invalid-parameter",
            "Last-Event-ID",
        ),
        case(
            "stream of an unknown route",
            get("/v1/alerts/stream?route_id=nowhere"),
            404,
            "unknown-route",
            "",
        ),
    ]
}

fn ids() -> Vec<Case> {
    let mut cases = Vec::new();
    for (name, below) in [
        ("unknown alert", ""),
        ("evidence of an unknown alert", "/evidence"),
        ("picture of an unknown alert", "/evidence.svg"),
    ] {
        let request = get(&format!("/v1/alerts/{UNKNOWN}{below}"));
        cases.push(case(name, request, 404, "not-found", ""));
    }
    let nobody = post(UNKNOWN, "accept").header("if-match", "*");
    let no_uuid = get("/v1/alerts/7");
    let no_action = post(APPEARED, "close").header("if-match", "*");
    cases.extend([
        case(
            "decision about an unknown alert",
            nobody,
            404,
            "not-found",
            "",
        ),
        case(
            "alert id that is no UUID",
            no_uuid,
            400,
            "invalid-field",
            "",
        ),
        case("unknown action", no_action, 404, "not-found", ""),
        case(
            "action read",
            get(&format!("/v1/alerts/{APPEARED}/accept")),
            405,
            "method-not-allowed",
            "",
        ),
        case(
            "parameter of an alert",
            get(&format!("/v1/alerts/{APPEARED}?all=1")),
            400,
            "invalid-parameter",
            "",
        ),
    ]);
    cases
}

fn decisions() -> Vec<Case> {
    let long_note = json!({"note": "x".repeat(2_001)});
    let raw = post(APPEARED, "dismiss")
        .header("if-match", "\"1\"")
        .header("content-type", "application/json");
    vec![
        case(
            "decision without If-Match",
            post(APPEARED, "accept"),
            428,
            "precondition-required",
            "If-Match",
        ),
        case(
            "decision about an older revision",
            post(APPEARED, "accept").header("if-match", "\"0\""),
            412,
            "precondition-failed",
            "If-Match",
        ),
        case(
            "weak ETag",
            post(APPEARED, "accept").header("if-match", "W/\"1\""),
            412,
            "precondition-failed",
            "If-Match",
        ),
        case(
            "undo of what was not accepted",
            post(APPEARED, "undo").header("if-match", "\"1\""),
            409,
            "transition-not-allowed",
            "",
        ),
        case(
            "acceptance of what is resolved",
            post(DISAPPEARED, "accept").header("if-match", "\"1\""),
            409,
            "transition-not-allowed",
            "",
        ),
        case(
            "broken JSON",
            raw.clone().body("{"),
            400,
            "malformed-json",
            "",
        ),
        case("array", raw.clone().body("[]"), 400, "invalid-field", ""),
        case(
            "unknown field",
            decision(json!({"why": "x"})),
            400,
            "malformed-json",
            "/why",
        ),
        case(
            "note that is a number",
            decision(json!({"note": 1})),
            400,
            "invalid-field",
            "/note",
        ),
        case(
            "note of 2,001 characters",
            decision(long_note),
            422,
            "out-of-range",
            "/note",
        ),
        case(
            "note with NUL",
            decision(json!({"note": "a\0"})),
            422,
            "out-of-range",
            "/note",
        ),
        case(
            "empty name",
            decision(json!({"by": ""})),
            422,
            "out-of-range",
            "/by",
        ),
        case(
            "in the name of the service",
            decision(json!({"by": "System"})),
            422,
            "out-of-range",
            "/by",
        ),
        case(
            "form",
            post(APPEARED, "dismiss")
                .header("if-match", "*")
                .header("content-type", "application/x-www-form-urlencoded")
                .body("note=x"),
            415,
            "unsupported-media-type",
            "",
        ),
    ]
}

#[tokio::test]
async fn bad_requests_about_alerts_get_the_answers_of_the_contract() {
    let service = changed_hall::start().await;
    let pole = json!({"geo_anchor": {"latitude": -90, "longitude": 0, "heading": 0}});
    let pole = Request::new("PUT", "/v1/routes/pole").json(&pole);
    assert_eq!(service.send(pole).await.status, 201);
    check(
        &service,
        lists().into_iter().chain(ids()).chain(decisions()),
    )
    .await;
    let alert = service.get(&format!("/v1/alerts/{APPEARED}")).await;
    assert_eq!(alert.json()["revision"], 1, "nothing was decided");
    service.stop().await;
}
