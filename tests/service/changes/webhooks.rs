//! From a changed world to the receiver of a webhook.

use mapshift::webhooks::{DeliveryOptions, ReceiverPolicy};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::reported::{ROUTE, after_lap, alerts, only};
use super::shop::Shop;
use crate::receiver::Receiver;
use crate::running::Running;

const CHANGED_LAP: usize = 2;

#[tokio::test(flavor = "multi_thread")]
async fn a_receiver_is_reported_what_comes_and_what_is_decided_in_order() {
    let shop = Shop::new(5).with_crate(CHANGED_LAP, None);
    let directory = TempDir::new().unwrap();
    let options = DeliveryOptions {
        policy: ReceiverPolicy::PrivateToo,
        ..DeliveryOptions::default()
    };
    let service = Running::start_delivering(directory.path(), options).await;
    let client = &service.client;
    client.put_route(ROUTE, Value::Null).await;
    let mut receiver = Receiver::start().await;
    let body = json!({"url": receiver.url, "route_id": ROUTE, "include_tentative": true});
    let webhook = client.register_webhook(body).await;
    let secret = webhook["secret"].as_str().unwrap();
    for lap in 0..CHANGED_LAP {
        assert_eq!(after_lap(client, &shop, lap).await, Vec::<Value>::new());
    }
    assert!(!receiver.has_call(), "nothing has changed yet");

    let alert = only(after_lap(client, &shop, CHANGED_LAP).await);
    let accepted = client.decide(&alert, "accept").await;
    // Raised, perhaps changed by later batches of the lap, accepted.
    let mut event = receiver.call().await.verified(secret);
    assert_eq!(event["type"], "alert.raised", "{event}");
    let last = accepted["revision"].as_i64().unwrap();
    loop {
        assert_eq!(event["data"]["id"], alert["id"]);
        let revision = event["data"]["revision"].as_i64().unwrap();
        if revision == last {
            break;
        }
        event = receiver.call().await.verified(secret);
        assert_eq!(event["type"], "alert.updated", "{event}");
        let next = event["data"]["revision"].as_i64().unwrap();
        assert!(next > revision, "{next} after {revision}");
    }
    assert_eq!(event["data"], accepted);
    assert_eq!(event["data"], only(alerts(client).await));
    assert!(!receiver.has_call());
    service.stop().await;
}
