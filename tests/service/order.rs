//! The order of arrival is not the order of the drive.

use serde_json::{Value, json};

use crate::client::Put;
use crate::drives::{
    Batch, Drive, first_vehicle, interleaved, second_vehicle, shuffled, two_vehicles, workshop,
};
use crate::running::Running;
use crate::state::State;

const SCANS: usize = 12;

/// Metres and degrees within which two maps are the same.
type Same = (f64, f64);
/// Where every place is seen again and again.
const IN_A_LOOP: Same = (0.01, 0.1);
/// At the open end of a drive that never comes back, 36 m from where it began: about as far as
/// each of the two maps is from the truth there.
const AT_AN_OPEN_END: Same = (0.03, 0.2);

async fn map_of(uploads: &[Batch]) -> State {
    let service = Running::start().await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    client.put_all("line", uploads).await;
    let batches = client.merged("line").await;
    assert!(batches.iter().all(|b| b["flags"] == json!([])));
    let state = State::of(client, "line").await;
    service.stop().await;
    state
}

async fn any_order_is_as_good(drives: [Drive; 2], (same_m, same_deg): Same) {
    let drives = drives.map(|drive| drive.batches(SCANS));
    let in_order = map_of(&drives.concat()).await;

    // Whoever waits for a predecessor keeps the place of its arrival: the work is the same.
    let reversed = drives.clone().map(|mut drive| {
        drive.reverse();
        drive
    });
    assert!(map_of(&reversed.concat()).await == in_order);
    assert!(map_of(&interleaved(&reversed)).await == in_order);

    let mut orders = vec![interleaved(&drives)];
    for seed in 0..3 {
        // The trip that comes first defines the map's frame, so that one stays in front.
        let mut rest = drives.concat();
        let mut uploads = vec![rest.remove(0)];
        uploads.extend(shuffled(rest, seed));
        orders.push(uploads);
    }
    for uploads in orders {
        let (metres, radians) = map_of(&uploads).await.distance_to(&in_order);
        let order: Vec<&str> = uploads.iter().map(|batch| batch.id.as_str()).collect();
        let degrees = radians.to_degrees();
        let same = metres < same_m && degrees < same_deg;
        assert!(same, "{metres} m, {degrees}° after {order:?}");
    }
}

/// Two vehicles that drive twice round a workshop.
fn in_a_loop() -> [Drive; 2] {
    let workshop = workshop();
    let laps = |vehicle, names, seed| Drive::through(&workshop, &vehicle, names, 96, seed);
    [
        laps(first_vehicle(), ("agv-01", "one"), 1),
        laps(second_vehicle(), ("agv-02", "two"), 2),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn trips_that_say_where_they_start_may_come_in_any_order() {
    any_order_is_as_good(in_a_loop(), IN_A_LOOP).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn trips_that_are_anchored_may_come_in_any_order() {
    let [first, second] = in_a_loop();
    any_order_is_as_good([first, second.without_pose()], IN_A_LOOP).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn drives_that_never_come_back_may_come_in_any_order() {
    let [first, second] = two_vehicles(72);
    any_order_is_as_good([first, second.without_pose()], AT_AN_OPEN_END).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn repeats_change_nothing() {
    let drives = two_vehicles(36).map(|drive| drive.batches(SCANS));
    let once = map_of(&interleaved(&drives)).await;
    let service = Running::start().await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    for batch in &interleaved(&drives) {
        assert_eq!(client.put("line", batch).await, Put::Stored);
        assert_eq!(client.put("line", batch).await, Put::Replayed);
    }
    client.merged("line").await;
    assert!(State::of(client, "line").await == once);
    service.stop().await;
}
