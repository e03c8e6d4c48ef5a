//! People decide while vehicles drive: nobody is refused because of more of the same evidence.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use mapshift::geometry::{Vector2, distance_to_polygon};
use serde_json::{Value, json};

use crate::changes::Shop;
use crate::client::Client;
use crate::running::Running;

/// The lap that first shows the crate.
const CHANGED_LAP: usize = 2;

/// How much is decided about how much.
struct Plan {
    routes: usize,
    people: usize,
    /// Decisions of each of them.
    decisions: usize,
    /// How old a view is when somebody decides on it.
    view_age: Duration,
}

#[tokio::test(flavor = "multi_thread")]
async fn people_decide_while_vehicles_drive() {
    let plan = Plan {
        routes: 2,
        people: 3,
        decisions: 10,
        view_age: Duration::from_millis(100),
    };
    decide_while_driving(&plan).await;
}

/// `cargo test --release --test service -- --ignored a_thousand_decisions`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes"]
async fn a_thousand_decisions_while_vehicles_drive() {
    let plan = Plan {
        routes: 10,
        people: 3,
        decisions: 334,
        view_age: Duration::from_millis(1_500),
    };
    decide_while_driving(&plan).await;
}

/// On every route a vehicle drives lap after lap, and the alert about a crate grows.
async fn decide_while_driving(plan: &Plan) {
    let service = Running::start().await;
    let client = &service.client;
    let routes: Vec<String> = (0..plan.routes).map(|k| format!("line-{k}")).collect();
    for (seed, route) in (5..).zip(&routes) {
        client.put_route(route, Value::Null).await;
        let shop = Shop::new(seed).with_crate(CHANGED_LAP, None);
        for lap in 0..=CHANGED_LAP {
            client.put_all(route, &shop.lap(lap)).await;
        }
    }
    for route in &routes {
        client.merged(route).await;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let vehicles = (5..).zip(routes.clone()).map(|(seed, route)| {
        tokio::spawn(drive_on(client.clone(), route, seed, Arc::clone(&stop)))
    });
    let vehicles: Vec<_> = vehicles.collect();
    let people = (0..plan.people)
        .map(|k| tokio::spawn(decide(client.clone(), k, plan.decisions, plan.view_age)));
    let mut refused = 0;
    for person in people.collect::<Vec<_>>() {
        refused += person.await.unwrap();
    }
    stop.store(true, Ordering::SeqCst);
    let mut laps = 0;
    for vehicle in vehicles {
        laps += vehicle.await.unwrap();
    }
    let decisions = plan.people * plan.decisions;
    eprintln!("{refused} of {decisions} decisions refused, {laps} laps driven meanwhile");
    assert!(laps > 0 && refused < decisions);
    service.stop().await;
}

/// Drives until it is enough; the number of laps.
async fn drive_on(client: Client, route: String, seed: u64, stop: Arc<AtomicBool>) -> usize {
    let shop = Shop::new(seed).with_crate(CHANGED_LAP, None);
    let mut laps = 0;
    while laps == 0 || !stop.load(Ordering::SeqCst) {
        laps += 1;
        client.put_all(&route, &shop.lap(CHANGED_LAP + laps)).await;
        client.settled(&route, true).await;
    }
    laps
}

/// Decides about whatever there is, on views that are old already; the number of refusals.
async fn decide(client: Client, person: usize, decisions: usize, view_age: Duration) -> usize {
    let (mut made, mut refused) = (0, 0);
    while made < decisions {
        let views = client.list("/v1/alerts", 100).await;
        tokio::time::sleep(view_age).await;
        for view in &views {
            // Accepting ends the growth of an alert.
            let actions = view["actions"].as_array().unwrap().iter();
            let actions: Vec<&str> = actions
                .map(|action| action.as_str().unwrap())
                .filter(|action| *action != "accept" && *action != "undo")
                .collect();
            if made == decisions || actions.is_empty() {
                continue;
            }
            let action = actions[(made + person) % actions.len()];
            refused += usize::from(!decide_on(&client, view, action).await);
            made += 1;
        }
    }
    refused
}

/// Whether a decision on a view was taken; one that was not must be for a reason that people accept.
async fn decide_on(client: &Client, view: &Value, action: &str) -> bool {
    let one = json!({
        "id": view["id"], "action": action, "if_match": view["decision_revision"],
    });
    let body = json!({"decisions": [one], "by": "A. Keeper"});
    let (status, answer) = client.post("/v1/alerts/decisions".to_owned(), body).await;
    assert_eq!(status, 200, "{answer}");
    let item = &answer["items"][0];
    match item["result"].as_str().unwrap() {
        "done" | "already_done" => true,
        "changed" => {
            assert!(
                is_another(view, &item["alert"]),
                "{view}\n{}",
                item["alert"]
            );
            false
        }
        other => panic!("{other}: {item}"),
    }
}

/// Whether what a decision is about has changed: the status, if only for a while, the tier, the kind, or
/// where it is.
fn is_another(view: &Value, now: &Value) -> bool {
    let entries = |alert: &Value| alert["history"].as_array().unwrap().len();
    entries(now) > entries(view)
        || view["tier"] != now["tier"]
        || view["kind"] != now["kind"]
        || farthest_m(&region(view), &region(now)) > 0.0
}

fn region(alert: &Value) -> Vec<Vector2<f64>> {
    let corners: Vec<[f64; 2]> = serde_json::from_value(alert["region"].clone()).unwrap();
    corners.into_iter().map(Vector2::from).collect()
}

fn farthest_m(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> f64 {
    let from_a = a.iter().map(|corner| distance_to_polygon(corner, b));
    let from_b = b.iter().map(|corner| distance_to_polygon(corner, a));
    from_a.chain(from_b).fold(0.0, f64::max)
}
