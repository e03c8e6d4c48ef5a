//! Vehicles that somebody keeps out of a map.

use serde_json::{Value, json};

use crate::client::Client;
use crate::drives::{Batch, Drive, HALL, first_vehicle, two_vehicles};
use crate::odd_trips::ended;
use crate::running::Running;

async fn end_as(client: &Client, batches: &[Batch], status: &str) -> Value {
    client.put_all("line", batches).await;
    let mut last = Value::Null;
    for batch in batches {
        last = ended(client, &batch.id).await;
        assert_eq!(last["status"], status, "{last}");
    }
    last
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_of_a_quarantined_vehicle_reaches_the_map_until_it_is_released() {
    let service = Running::start().await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    let [first, second] = two_vehicles(48);
    end_as(client, &first.batches(12), "merged").await;
    let nodes = client.route("line").await["counts"]["nodes"].clone();

    let vehicle = "/v1/routes/line/vehicles/agv-01";
    assert_eq!(client.json(vehicle).await["state"], "trusted");
    let put_out = |note: &str| client.post(format!("{vehicle}/quarantine"), json!({"note": note}));
    let (status, reported) = put_out("its mount is loose").await;
    assert_eq!(
        (status, &reported["state"]),
        (200, &json!("quarantined")),
        "{reported}"
    );
    let (_, again) = put_out("another note").await;
    assert_eq!(again, reported, "the first note stays");
    assert!(
        reported["reasons"][0]
            .as_str()
            .unwrap()
            .ends_with("its mount is loose")
    );

    let next = Drive::through(&HALL, &first_vehicle(), ("agv-01", "next"), 48, 5).batches(12);
    let refused = end_as(client, &next, "quarantined").await;
    let reason = refused["reason"].as_str().unwrap();
    assert!(reason.ends_with("its mount is loose"), "{reason}");
    assert_eq!(client.route("line").await["counts"]["nodes"], nodes);
    end_as(client, &second.batches(12), "merged").await;

    let (status, reported) = client.post(format!("{vehicle}/release"), Value::Null).await;
    assert_eq!(
        (status, &reported["state"]),
        (200, &json!("suspect")),
        "{reported}"
    );
    assert!(
        reported["reasons"][0]
            .as_str()
            .unwrap()
            .starts_with("4 of its newest batches")
    );
    for batch in &next {
        assert_eq!(client.retry("line", &batch.id).await.0, 202);
        assert_eq!(ended(client, &batch.id).await["status"], "merged");
    }
    assert_eq!(client.json(vehicle).await["state"], "trusted");

    let nobody = "/v1/routes/line/vehicles/nobody/quarantine";
    assert_eq!(client.post(nobody.to_owned(), json!({})).await.0, 404);
    let long = json!({"note": "n".repeat(2_001)});
    let (status, problem) = client.post(format!("{vehicle}/quarantine"), long).await;
    assert_eq!(
        (status, &problem["errors"][0]["pointer"]),
        (422, &json!("/note")),
        "{problem}"
    );
    service.stop().await;
}
