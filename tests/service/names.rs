//! Names and addresses of people are nowhere once their time is over, and the map is still rebuilt from the journal.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

use mapshift::api::{AccessOptions, TrustedProxies};
use mapshift::config::AppConfig;
use mapshift::pipeline::PipelineOptions;
use mapshift::store::{SYSTEM, fsck};
use serde_json::{Value, json};
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;
use tempfile::TempDir;

use crate::changes::{ROUTE, alerts};
use crate::client::Client;
use crate::replay::{live_through_everything, replay};
use crate::running::{Running, config_in};
use crate::tables::columns_with;

const NAME: &str = "Kim Canary";
/// The address of the proxy.
const ADDRESS: &str = "127.0.0.1";
const PATIENCE: Duration = Duration::from_secs(120);

fn config(directory: &Path, keep_names: Option<Duration>) -> AppConfig {
    let proxies = TrustedProxies {
        networks: vec!["127.0.0.0/8".parse().unwrap()],
        roles: vec!["keepers=admin".parse().unwrap()],
    };
    AppConfig {
        pipeline: PipelineOptions {
            keep_names,
            ..PipelineOptions::default()
        },
        access: AccessOptions {
            proxies,
            ..AccessOptions::default()
        },
        ..config_in(directory)
    }
}

async fn start(directory: &Path, keep_names: Option<Duration>) -> Running {
    let client = |url: &str| Client::signed_in(url, NAME);
    Running::start_with(config(directory, keep_names), client).await
}

/// The columns of all tables that hold a text.
async fn found(directory: &Path, text: &str) -> BTreeSet<String> {
    let file = directory.join("data").join("mapshift.db");
    let options = SqliteConnectOptions::new().filename(file).read_only(true);
    columns_with(&mut options.connect().await.unwrap(), text).await
}

/// What names stand in beside a map's own history: assignments, several decisions at once, and keys.
async fn handle(client: &Client) {
    let known = alerts(client).await;
    let path = |alert: &Value, rest: &str| {
        let id = alert["id"].as_str().unwrap();
        format!("/v1/alerts/{id}/{rest}")
    };
    let is_pending =
        |alert: &&Value| ["open", "acknowledged"].contains(&alert["status"].as_str().unwrap());
    let past = known.iter().find(|alert| !is_pending(alert)).unwrap();
    let assignee = json!({"assignee": NAME});
    let (status, answer) = client.put_body(path(past, "assignee"), &assignee).await;
    assert_eq!(status, 200, "{answer}");
    // Two acceptances are an operation, and each of these is refused.
    let accept = |id: Value| json!({"id": id, "action": "accept", "if_match": "\"1\""});
    let unknown = json!("019aa000-0000-7000-8000-000000000001");
    let body = json!({"decisions": [accept(past["id"].clone()), accept(unknown)]});
    let (status, answer) = client.post("/v1/alerts/decisions".to_owned(), body).await;
    assert_eq!(status, 202, "{answer}");
    let operation = format!("/v1/operations/{}", answer["id"].as_str().unwrap());
    let ended = client.ended_operation(&operation).await;
    assert_eq!(ended["status"], "succeeded", "{ended}");
    let body = json!({"name": NAME, "role": "viewer"});
    let (status, key) = client.post("/v1/keys".to_owned(), body).await;
    assert_eq!(status, 201, "{key}");
    client
        .delete(&format!("/v1/keys/{}", key["id"].as_str().unwrap()))
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn redacted_names_are_nowhere_and_the_map_is_rebuilt_as_it_is() {
    let directory = TempDir::new().unwrap();
    let service = start(directory.path(), None).await;
    live_through_everything(&service.client).await;
    handle(&service.client).await;
    service.stop().await;
    assert!(found(directory.path(), NAME).await.len() > 8);
    assert!(!found(directory.path(), ADDRESS).await.is_empty());

    let service = start(directory.path(), Some(Duration::ZERO)).await;
    let give_up = Instant::now() + PATIENCE;
    for text in [NAME, ADDRESS] {
        loop {
            let left = found(directory.path(), text).await;
            if left.is_empty() {
                break;
            }
            assert!(Instant::now() < give_up, "{text} is left in {left:?}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }
    let reported = alerts(&service.client).await;
    let entries = reported
        .iter()
        .flat_map(|alert| alert["history"].as_array().unwrap());
    let by: BTreeSet<&str> = entries.map(|entry| entry["by"].as_str().unwrap()).collect();
    assert_eq!(by, BTreeSet::from(["redacted", SYSTEM]));
    let versions = service
        .client
        .list(&format!("/v1/routes/{ROUTE}/versions"), 50)
        .await;
    assert!(
        versions
            .iter()
            .any(|version| version["cause"]["by"] == "redacted")
    );
    for row in service.client.list("/v1/audit", 100).await {
        let who = [&row["actor"], &row["address"]];
        assert!(who == ["redacted"; 2] || row["actor"] == SYSTEM, "{row}");
        assert_eq!(row["key_id"], Value::Null);
    }
    service.stop().await;

    let data = directory.path().join("data");
    let report = fsck(&data, true, &|_, _| {}).await.unwrap();
    assert!(report.sound, "{:?}", report.faults);
    let (ended_well, replayed) = replay(&data, &["--compare"]);
    assert!(
        ended_well && replayed["comparison"]["same"] == true,
        "{replayed}"
    );
    assert_eq!(replayed["decisions_left_out"], json!([]));
    assert_eq!(replayed["versions_left_out"], json!([]));
}
