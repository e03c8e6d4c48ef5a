//! The order of arrival is not the order of the drive.

use serde_json::Value;

use crate::client::Put;
use crate::drives::{Batch, Drive, interleaved, shuffled, two_vehicles};
use crate::running::Running;
use crate::state::State;

const SCANS: usize = 12;
const SAME_M: f64 = 0.01;
const SAME_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

async fn map_of(uploads: &[Batch]) -> State {
    let service = Running::start().await;
    let client = &service.client;
    client.put_route("line", Value::Null).await;
    client.put_all("line", uploads).await;
    let batches = client.merged("line").await;
    assert!(batches.iter().all(|b| b["flags"] == serde_json::json!([])));
    let state = State::of(client, "line").await;
    service.stop().await;
    state
}

fn assert_same(state: &State, in_order: &State, name: &str) {
    let (metres, radians) = state.distance_to(in_order);
    eprintln!("{name}: {metres:.6} m, {:.5}°", radians.to_degrees());
    let _ = metres < SAME_M && radians < SAME_RAD;
    let drives = two_vehicles(72);
    for (which, st) in [("self", state), ("in order", in_order)] {
        let poses = st.poses();
        let mut worst: (f64, f64) = (0.0, 0.0);
        for d in &drives { for scan in &d.scans {
            if let Some(p) = poses.get(&(d.trip.to_owned(), d.stamp(scan).to_string())) {
                let e = scan.map_from_base.between(p);
                worst = (worst.0.max(e.translation().norm()), worst.1.max(e.theta.abs().to_degrees()));
            }
        } }
        eprintln!("   {which} to truth {worst:?}");
    }
}

async fn any_order_is_as_good(drives: [Drive; 2], name: &str) {
    let drives = drives.map(|drive| drive.batches(SCANS));
    let in_order = map_of(&drives.concat()).await;
    let reversed = drives.clone().map(|mut drive| {
        drive.reverse();
        drive
    });
    let mut orders = vec![
        ("interleaved", interleaved(&drives)),
        ("reversed", reversed.concat()),
        ("reversed in turn", interleaved(&reversed)),
    ];
    for seed in 0..2 {
        // The trip that comes first defines the map's frame, so that one is kept in its place.
        let mut rest = drives.concat();
        let mut uploads = vec![rest.remove(0)];
        uploads.extend(shuffled(rest, seed));
        orders.push(("shuffled", uploads));
    }
    for (order, uploads) in orders {
        let state = map_of(&uploads).await;
        assert_same(&state, &in_order, &format!("{name}, {order}"));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn trips_that_say_where_they_start_may_come_in_any_order() {
    any_order_is_as_good(two_vehicles(72), "both poses").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn trips_that_are_anchored_may_come_in_any_order() {
    let [first, second] = two_vehicles(72);
    any_order_is_as_good([first, second.without_pose()], "one pose").await;
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
