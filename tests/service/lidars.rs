//! Trips of vehicles with a lidar at the front and one at the rear.

use std::f64::consts::PI;

use mapshift::sim::{Scene, SimLidar, SimScan, Vehicle};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::{Batch, Drive, first_vehicle, interleaved, shuffled, workshop};
use crate::running::Running;
use crate::state::State;

/// Of each lidar.
const SCANS: usize = 96;
const BATCH_SCANS: usize = 12;

/// A vehicle's trip twice round a workshop as batches of both lidars' scans.
fn batches(names: (&str, &str), seed: u64) -> Vec<Batch> {
    let lidars = SimLidar::front_and_rear(PI, 181, 20.0, 0.01);
    let vehicle = Vehicle {
        lidar: lidars[0].clone(),
        ..first_vehicle()
    };
    let scene = Scene::of_hall(&workshop(), 0);
    let of_rear = scene.drive_of_companion(&vehicle, (1, &lidars[1]), 0..3, seed);
    let fleet = lidars.map(|lidar| Vehicle {
        lidar,
        ..vehicle.clone()
    });
    let drive = |vehicle: &Vehicle, mut scans: Vec<SimScan>| {
        scans.truncate(SCANS);
        Drive::of(vehicle, names, scans, seed as i64)
    };
    let front = drive(&fleet[0], scene.drive(&vehicle, 0..3, seed));
    let rear = drive(&fleet[1], of_rear);
    let pairs = front.batches(BATCH_SCANS).into_iter();
    let pairs = pairs.zip(rear.batches(BATCH_SCANS));
    pairs.map(|(front, rear)| of_both(&front, &rear)).collect()
}

/// One batch of the scans of two, in the order of time.
fn of_both(front: &Batch, rear: &Batch) -> Batch {
    let mut body: Value = serde_json::from_slice(&front.body).unwrap();
    let other: Value = serde_json::from_slice(&rear.body).unwrap();
    let named = |mut value: Value, field: &str, name: &str| {
        value[field] = json!(name);
        value
    };
    let scans_of = |body: &Value| body["scans"].as_array().unwrap().clone();
    let pairs = scans_of(&body).into_iter().zip(scans_of(&other));
    let scans = pairs
        .flat_map(|(front, rear)| [named(rear, "lidar", "rear"), named(front, "lidar", "front")]);
    body["scans"] = scans.collect();
    let lidar = body.as_object_mut().unwrap().remove("lidar").unwrap();
    let (lidar, other) = (
        named(lidar, "id", "front"),
        named(other["lidar"].clone(), "id", "rear"),
    );
    body["lidars"] = json!([lidar, other]);
    Batch {
        id: front.id.clone(),
        body: serde_json::to_vec(&body).unwrap(),
    }
}

async fn all_of(client: &Client) -> (State, Value) {
    let poses = client
        .json("/v1/routes/line/trajectories/one?poses=all")
        .await;
    (State::of(client, "line").await, poses)
}

#[tokio::test(flavor = "multi_thread")]
async fn trips_of_two_lidars_come_in_any_order_and_through_a_restart() {
    let drives = [batches(("agv-01", "one"), 1), batches(("agv-02", "two"), 2)];
    let service = Running::start().await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    client.put_all("line", &drives.concat()).await;
    let reported = client.merged("line").await;
    assert!(
        reported.iter().all(|batch| batch["flags"] == json!([])),
        "{reported:?}"
    );
    let (in_order, poses) = all_of(client).await;
    let route = client.route("line").await;
    assert_eq!(route["counts"]["scans"], 4 * SCANS);
    // Both lidars' scans are on the trajectory, each at its pose.
    assert_eq!(poses["poses"].as_array().unwrap().len(), 2 * SCANS);
    service.stop().await;

    // Each trip's batches the other way round, with stops in between: the same to the bit.
    let reversed = drives.clone().map(|mut drive| {
        drive.reverse();
        drive
    });
    let directory = TempDir::new().unwrap();
    let service = Running::start_in(directory.path()).await;
    service.client.put_route("line", Value::Null).await;
    service.client.put_all("line", &reversed[0]).await;
    service.stop().await;
    let service = Running::start_in(directory.path()).await;
    service.client.put_all("line", &reversed[1]).await;
    service.stop().await;
    let service = Running::start_in(directory.path()).await;
    service.client.merged("line").await;
    let (again, poses_again) = all_of(&service.client).await;
    assert!(again == in_order, "{:?}", again.distance_to(&in_order));
    assert_eq!(poses_again, poses);
    service.stop().await;

    // In an order in which the trips grow side by side the poses differ by millimetres.
    let service = Running::start().await;
    service.client.put_route("line", Value::Null).await;
    let mut uploads = interleaved(&drives);
    let first = uploads.remove(0);
    service.client.put("line", &first).await;
    service.client.put_all("line", &shuffled(uploads, 1)).await;
    service.client.merged("line").await;
    let (metres, radians) = all_of(&service.client).await.0.distance_to(&in_order);
    assert!(metres < 0.01 && radians < 0.002, "{metres} m, {radians}");
    service.stop().await;
}
