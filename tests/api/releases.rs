//! Versions of a map that are released for vehicles, and their files.

use serde_json::{Value, json};

use crate::changed_hall::{self, APPEARED};
use crate::client::{Answer, Request};
use crate::service::Service;

const HALL: &str = "/v1/routes/hall";

async fn post(service: &Service, path: &str, body: Value) -> Answer {
    let request = Request::new("POST", format!("{HALL}/versions/{path}"));
    service.send(request.json(&body)).await
}

async fn accept(service: &Service) {
    let accept = Request::new("POST", format!("/v1/alerts/{APPEARED}/accept"));
    let accepted = service.send(accept.header("if-match", "*")).await;
    assert_eq!(accepted.status, 200, "{}", accepted.text());
}

async fn file(service: &Service, path: &str) -> Vec<u8> {
    let answer = service.get(&format!("{HALL}/{path}")).await;
    assert_eq!(answer.status, 200, "{path}");
    answer.body
}

#[tokio::test]
async fn a_released_version_never_changes() {
    let service = changed_hall::start().await;
    let draft = file(&service, "map.pgm").await;
    let answer = post(&service, "1/release", json!({"note": "for the shift"})).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    let released = answer.json();
    let said = |field: &str| released[field].clone();
    assert_eq!(
        (said("state"), said("current")),
        (json!("released"), json!(false))
    );
    assert_eq!(
        (&released["released"]["by"], &released["released"]["note"]),
        (&json!("local"), &json!("for the shift"))
    );
    assert_eq!(file(&service, "versions/1/map.pgm").await, draft);

    // The route goes on; what it offers to vehicles stays.
    accept(&service).await;
    assert_ne!(file(&service, "versions/3/map.pgm").await, draft);
    assert_ne!(file(&service, "map.pgm?layer=observed").await, draft);
    for path in ["map.pgm", "map.pgm?layer=accepted", "versions/1/map.pgm"] {
        assert_eq!(file(&service, path).await, draft, "{path}");
    }
    let list = service.get(&format!("{HALL}/versions")).await.json();
    let items = list["items"].as_array().unwrap();
    let answered: Vec<Value> = items
        .iter()
        .map(|v| {
            json!([
                v["version"],
                v["epoch"],
                v["state"],
                v["cause"]["action"],
                v["max_displacement_m"]
            ])
        })
        .collect();
    let moved_m = &items[2]["max_displacement_m"];
    assert!(moved_m.is_f64(), "{list}");
    assert_eq!(
        answered,
        [
            json!([1, 1, "released", null, null]),
            json!([2, 1, "retired", "release", 0.0]),
            json!([3, 2, "draft", "accept", moved_m]),
        ]
    );
    assert_eq!(items[1]["cause"]["alert_id"], Value::Null);
    assert_eq!(items[1]["cause"]["note"], "for the shift");
    assert_eq!(items[2]["cause"]["alert_id"], APPEARED);

    // The next release takes its place, until it is withdrawn.
    assert_eq!(post(&service, "3/release", json!({})).await.status, 200);
    let third = file(&service, "versions/3/map.pgm").await;
    assert_eq!(file(&service, "map.pgm").await, third);
    assert_ne!(third, draft);
    let retired = post(&service, "3/retire", json!({})).await;
    assert_eq!(retired.json()["state"], "retired");
    assert_eq!(file(&service, "map.pgm").await, draft);
    assert_eq!(file(&service, "versions/3/map.pgm").await, third);
    service.stop().await;
}

#[tokio::test]
async fn a_release_can_be_repeated_and_needs_a_map() {
    let service = changed_hall::start().await;
    let first = post(&service, "1/release", json!({"note": "one"}))
        .await
        .json();
    let again = post(&service, "1/release", json!({"note": "two"})).await;
    assert_eq!((again.status, again.json()), (200, first));
    let read = service.get(&format!("{HALL}/versions/1")).await.json();
    assert_eq!(read, again.json());
    let retired = post(&service, "1/retire", json!({})).await.json();
    assert_eq!(post(&service, "1/retire", json!({})).await.json(), retired);
    let nowhere = Request::new("POST", "/v1/routes/yard/versions/1/release");
    let empty = service.send(nowhere).await;
    for (answer, status, problem, says) in [
        (
            post(&service, "1/release", json!({})).await,
            409,
            "version-state",
            "has ended",
        ),
        (
            post(&service, "2/retire", json!({})).await,
            409,
            "version-state",
            "is the draft",
        ),
        (
            post(&service, "9/release", json!({})).await,
            404,
            "not-found",
            "",
        ),
        (
            post(&service, "9/retire", json!({})).await,
            404,
            "not-found",
            "",
        ),
        (
            post(&service, "2/release", json!({"note": 5})).await,
            400,
            "invalid-field",
            "",
        ),
        (empty, 409, "version-state", "nothing has been merged"),
    ] {
        assert_eq!(
            (answer.status, answer.problem().as_str()),
            (status, problem)
        );
        let detail = answer.json()["detail"].as_str().unwrap().to_owned();
        assert!(detail.contains(says), "{detail}");
    }
    let unknown = service.get(&format!("{HALL}/versions/9")).await;
    assert_eq!(unknown.status, 404);
    service.stop().await;
}

#[tokio::test]
async fn ended_versions_are_cached_for_ever_and_drafts_are_revalidated() {
    let service = changed_hall::start().await;
    let caching = async |path: &str| {
        let answer = service.get(&format!("{HALL}/{path}")).await;
        let header = |name| answer.header(name).unwrap().to_owned();
        (header("cache-control"), header("etag"))
    };
    let (draft, tag) = caching("map.png").await;
    assert_eq!(draft, "no-cache");
    assert_eq!(
        caching("versions/1/map.png").await,
        (draft.clone(), tag.clone())
    );
    assert_eq!(post(&service, "1/release", json!({})).await.status, 200);
    let (still, next) = caching("map.png").await;
    assert_eq!(still, draft, "another version may be released");
    assert_ne!(next, tag);
    let (fixed, _) = caching("versions/1/map.png").await;
    assert_eq!(fixed, "private, max-age=31536000, immutable");
    accept(&service).await;
    assert_eq!(caching("map.png").await, (still, next.clone()));
    let again = Request::new("GET", format!("{HALL}/map.png"));
    let again = service.send(again.header("if-none-match", &next)).await;
    assert_eq!(again.status, 304);
    service.stop().await;
}

#[tokio::test]
async fn vehicles_get_only_released_versions() {
    let service = changed_hall::start().await;
    let path = format!("{HALL}/versions/1/vda5050");
    let draft = service.get(&path).await;
    let answered = (draft.status, draft.problem());
    assert_eq!(answered, (409, "version-state".to_owned()));
    let released = post(&service, "1/release", json!({})).await.json();
    let map = |action: &str, more: Vec<Value>| {
        let id = json!({"key": "mapId", "value": "hall"});
        let version = json!({"key": "mapVersion", "value": "1"});
        let parameters = [vec![id, version], more].concat();
        json!({
            "actionType": action, "actionId": format!("{action}-hall-1"), "blockingType": "NONE",
            "actionParameters": parameters,
        })
    };
    let link = format!("http://localhost{HALL}/versions/1/map.pgm");
    let download = vec![
        json!({"key": "mapDownloadLink", "value": link}),
        json!({"key": "mapHash", "value": released["sha256"]}),
    ];
    let actions = json!([map("downloadMap", download), map("enableMap", Vec::new())]);
    for (query, version) in [
        ("", "2.1.0"),
        ("?vda5050=2.1", "2.1.0"),
        ("?vda5050=3.0", "3.0.0"),
    ] {
        let body = service.get(&format!("{path}{query}")).await.json();
        assert_eq!(body, json!({"version": version, "actions": actions}));
    }
    let unknown = service.get(&format!("{path}?vda5050=1.0")).await;
    assert_eq!(
        (unknown.status, unknown.problem()),
        (400, "invalid-parameter".to_owned())
    );
    post(&service, "1/retire", json!({})).await;
    assert_eq!(service.get(&path).await.status, 409);
    service.stop().await;
}

#[tokio::test]
async fn download_links_have_the_public_url_or_the_host() {
    let directory = changed_hall::directory().await;
    let url = "https://maps.example.com".parse().unwrap();
    let service = Service::start_changed(directory, |config| {
        config.access.public_url = Some(url);
    });
    let service = service.await;
    assert_eq!(post(&service, "1/release", json!({})).await.status, 200);
    let path = format!("{HALL}/versions/1/vda5050");
    let body = service.get(&path).await.json();
    let parameters = body["actions"][0]["actionParameters"].as_array().unwrap();
    let link = json!({
        "key": "mapDownloadLink",
        "value": format!("https://maps.example.com{HALL}/versions/1/map.pgm"),
    });
    assert!(parameters.contains(&link), "{body}");
    service.stop().await;
}
