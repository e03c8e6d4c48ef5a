//! A service that is stopped in order goes on where it was.

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::drives::{interleaved, two_vehicles};
use crate::running::Running;
use crate::state::State;

#[tokio::test(flavor = "multi_thread")]
async fn what_was_queued_at_the_stop_is_done_after_the_start() {
    let uploads = interleaved(&two_vehicles(72).map(|drive| drive.batches(12)));
    let undisturbed = {
        let service = Running::start().await;
        service.client.put_route("line", Value::Null).await;
        service.client.put_all("line", &uploads).await;
        service.client.merged("line").await;
        let state = State::of(&service.client, "line").await;
        service.stop().await;
        state
    };

    let directory = TempDir::new().unwrap();
    let service = Running::start_in(directory.path()).await;
    service.client.put_route("line", Value::Null).await;
    service.client.put_all("line", &uploads).await;
    let pending = service.client.route("line").await["pending_batches"].clone();
    service.stop().await;
    assert_ne!(pending, 0, "the stop came too late to show anything");

    // Once more, before it is through.
    Running::start_in(directory.path()).await.stop().await;
    let service = Running::start_in(directory.path()).await;
    service.client.merged("line").await;
    let state = State::of(&service.client, "line").await;
    assert!(
        state == undisturbed,
        "{:?}",
        state.distance_to(&undisturbed)
    );
    service.stop().await;
}

/// The setting counts from the next batch on, whether the map is in memory or not.
#[tokio::test(flavor = "multi_thread")]
async fn another_detector_needs_no_restart() {
    let [first, _] = two_vehicles(24);
    let batches = first.batches(12);
    let directory = TempDir::new().unwrap();
    let service = Running::start_in(directory.path()).await;
    let client = &service.client;
    for route in ["in-memory", "restarted"] {
        client.put_route(route, Value::Null).await;
        client.put(route, &batches[0]).await;
        client.merged(route).await;
        client.put_route(route, json!({"detector": "seed"})).await;
    }
    client.put("in-memory", &batches[1]).await;
    client.merged("in-memory").await;
    let in_memory = State::of(client, "in-memory").await;
    service.stop().await;

    let service = Running::start_in(directory.path()).await;
    service.client.put("restarted", &batches[1]).await;
    service.client.merged("restarted").await;
    let restarted = State::of(&service.client, "restarted").await;
    let identity = json!([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
    let last = restarted.edges.last().unwrap();
    assert_eq!(last["information"], identity);
    assert!(in_memory == restarted);
    service.stop().await;
}
