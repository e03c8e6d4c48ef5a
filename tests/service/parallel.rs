//! Many gateways at once.

use serde_json::{Value, json};

use crate::drives::{Drive, HALL, first_vehicle, second_vehicle};
use crate::running::Running;
use crate::state::State;

const ROUTES: [&str; 2] = ["east", "west"];
const VEHICLES: [(&str, &str); 4] = [
    ("agv-01", "one"),
    ("agv-02", "two"),
    ("agv-03", "three"),
    ("agv-04", "four"),
];
const BATCHES: usize = 10;
const SCANS: usize = 5;

#[tokio::test(flavor = "multi_thread")]
async fn eight_gateways_fill_two_routes() {
    let service = Running::start().await;
    for route in ROUTES {
        service.client.put_route(route, Value::Null).await;
    }
    let mut gateways = Vec::new();
    for route in ROUTES {
        for (k, names) in VEHICLES.into_iter().enumerate() {
            let vehicle = if k % 2 == 0 {
                first_vehicle()
            } else {
                second_vehicle()
            };
            let drive = Drive::through(&HALL, &vehicle, names, BATCHES * SCANS, k as u64);
            let client = service.client.clone();
            gateways.push(tokio::spawn(async move {
                client.put_all(route, &drive.batches(SCANS)).await;
            }));
        }
    }
    for gateway in gateways {
        gateway.await.unwrap();
    }

    let mut keyframes = Vec::new();
    for route in ROUTES {
        let batches = service.client.merged(route).await;
        assert_eq!(batches.len(), VEHICLES.len() * BATCHES);
        let state = State::of(&service.client, route).await;
        let reported = service.client.route(route).await;
        let closures = state.edges.iter().filter(|e| e["kind"] == "loop_closure");
        let closures = closures.count();
        let subgraphs = reported["counts"]["subgraphs"].clone();
        assert_eq!(
            reported["counts"],
            json!({
                "batches": batches.len(), "scans": batches.len() * SCANS,
                "nodes": state.nodes.len(), "edges": state.edges.len(),
                "loop_closures": closures, "subgraphs": subgraphs,
                "vehicles": VEHICLES.len(), "open_alerts": 0,
            })
        );
        let sum = |field: &str| -> i64 { batches.iter().map(|b| b[field].as_i64().unwrap()).sum() };
        assert_eq!(sum("nodes_added"), state.nodes.len() as i64);
        assert_eq!(sum("loop_closures"), closures as i64);
        assert_eq!(
            state.edges.len() - closures,
            state.nodes.len() - VEHICLES.len()
        );
        keyframes.push(state.poses().into_keys().collect::<Vec<_>>());
    }
    assert_eq!(
        keyframes[0], keyframes[1],
        "the same drives, the same keyframes"
    );
    service.stop().await;
}
