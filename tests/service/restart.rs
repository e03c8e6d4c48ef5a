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

/// A map that one detector's rule made cannot go on by another's; other settings can change.
#[tokio::test(flavor = "multi_thread")]
async fn a_route_with_batches_keeps_its_detector() {
    let [first, _] = two_vehicles(24);
    let directory = TempDir::new().unwrap();
    let service = Running::start_in(directory.path()).await;
    let client = &service.client;
    client.put_route("line", json!({"detector": "fused"})).await;
    client.put_route("line", json!({"detector": "seed"})).await;
    client.put("line", &first.batches(12)[0]).await;
    client.merged("line").await;
    client.put_route("line", json!({"hold_s": 5})).await;
    let (status, problem) = client
        .route_refusal("line", json!({"detector": "fused"}))
        .await;
    assert_eq!(status, 409);
    assert_eq!(problem["type"], "/problems/detector-fixed");
    assert_eq!(problem["errors"][0]["pointer"], "/settings/detector");
    let last = State::of(client, "line").await.edges.pop().unwrap();
    assert_eq!(last["information"], json!([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]));
    service.stop().await;
}
