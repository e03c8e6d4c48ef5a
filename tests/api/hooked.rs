//! A changed hall whose service calls receivers on this machine.

use std::time::Duration;

use mapshift::api::Limits;
use mapshift::webhooks::{DeliveryOptions, ReceiverPolicy};
use serde_json::{Value, json};
use sqlx::{Connection, SqliteConnection};
use tempfile::TempDir;

use crate::changed_hall::{self, APPEARED};
use crate::client::Request;
use crate::receiver::Receiver;
use crate::service::Service;
use crate::webhooks::{deliveries, register};

pub const HOUR: Duration = Duration::from_hours(1);
/// What is waited for longer than this is missing.
const PATIENCE: Duration = Duration::from_secs(60);

/// To receivers on this machine, with the same pause after each of some failures.
pub fn options(pause: Duration) -> DeliveryOptions {
    DeliveryOptions {
        policy: ReceiverPolicy::PrivateToo,
        pauses: vec![pause; 3],
        ..DeliveryOptions::default()
    }
}

pub async fn start(pause: Duration) -> Service {
    start_in(changed_hall::directory().await, options(pause)).await
}

pub async fn start_in(directory: TempDir, options: DeliveryOptions) -> Service {
    Service::start_delivering(directory, Limits::default(), options).await
}

pub async fn registered(service: &Service, receiver: &Receiver) -> Value {
    register(service, json!({"url": receiver.url})).await
}

pub fn secret(webhook: &Value) -> &str {
    webhook["secret"].as_str().unwrap()
}

/// Makes something happen to the alert: the next of acknowledging and reopening.
pub async fn happen(service: &Service) -> Value {
    let alert = format!("/v1/alerts/{APPEARED}");
    let action = match service.get(&alert).await.json()["status"].as_str() {
        Some("open") => "acknowledge",
        _ => "reopen",
    };
    let request = Request::new("POST", format!("{alert}/{action}")).header("if-match", "*");
    let answer = service.send(request).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.json()
}

/// Waits until the newest delivery is as wanted.
pub async fn newest(
    service: &Service,
    webhook: &Value,
    is_wanted: impl Fn(&Value) -> bool,
) -> Value {
    let look = async {
        loop {
            let newest = deliveries(service, webhook).await.into_iter().next();
            match newest {
                Some(newest) if is_wanted(&newest) => return newest,
                _ => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    };
    let found = tokio::time::timeout(PATIENCE, look).await;
    found.expect("the delivery gets there")
}

pub async fn ended(service: &Service, webhook: &Value) -> Value {
    newest(service, webhook, |delivery| delivery["status"] != "pending").await
}

pub async fn tried(service: &Service, webhook: &Value) -> Value {
    newest(service, webhook, |delivery| delivery["attempts"] != 0).await
}

/// Moves every attempt that waits to the beginning of time.
pub async fn make_due(directory: &TempDir) {
    let path = directory.path().join("data/mapshift.db");
    let mut database = SqliteConnection::connect(path.to_str().unwrap())
        .await
        .unwrap();
    let statement = "UPDATE webhook_deliveries SET next_attempt_at_us = 0 WHERE status = 'pending'";
    sqlx::query(statement).execute(&mut database).await.unwrap();
    database.close().await.unwrap();
}
