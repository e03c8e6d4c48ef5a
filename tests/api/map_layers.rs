//! What viewers draw over a map.

use serde_json::{Value, json};

use crate::changed_hall;
use crate::service::Service;

const LAYERS: &str = "/v1/routes/hall/map/layers";

async fn layer(service: &Service, path: &str) -> Value {
    let answer = service.get(&format!("{LAYERS}/{path}")).await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.json()
}

#[tokio::test]
async fn layers_have_the_positions_of_nodes_and_edges() {
    let service = changed_hall::start().await;
    let graph = service.get("/v1/routes/hall/graph").await.json();
    let position = |id: &Value| {
        let nodes = graph["nodes"].as_array().unwrap();
        let pose = &nodes.iter().find(|node| node["id"] == *id).unwrap()["pose"];
        let rounded = |metres: &Value| (metres.as_f64().unwrap() * 100.0).round() / 100.0;
        json!([rounded(&pose["x"]), rounded(&pose["y"])])
    };
    let last = &graph["nodes"][2];
    let ids = [1, 2, 3].map(|id| json!(id));
    assert_eq!(
        layer(&service, "trajectories").await,
        json!({"items": [{
            "trip_id": "trip-1", "vehicle_id": "agv-07",
            "points": ids.each_ref().map(position),
            "last_stamp": last["stamp"], "last_pose": last["pose"],
        }]})
    );
    let edge = service.get("/v1/routes/hall/edges/3").await.json();
    assert_eq!(
        layer(&service, "residuals").await,
        json!({"items": [{
            "edge_id": 3, "kind": "loop_closure", "residual": edge["residual"],
            "from": position(&edge["from"]), "to": position(&edge["to"]),
        }]})
    );
    let nodes = graph["nodes"].as_array().unwrap().iter();
    let references = nodes.filter(|node| node["reference"] == true);
    let references: Vec<_> = references.map(|node| position(&node["id"])).collect();
    assert!(!references.is_empty());
    let keyframes = layer(&service, "keyframes").await;
    assert_eq!(keyframes, json!({"points": references}));
    service.stop().await;
}

#[tokio::test]
async fn a_route_without_a_map_has_empty_layers() {
    let service = changed_hall::start().await;
    for (path, empty) in [
        ("trajectories", json!({"items": []})),
        ("residuals", json!({"items": []})),
        ("keyframes", json!({"points": []})),
    ] {
        let answer = service
            .get(&format!("/v1/routes/yard/map/layers/{path}"))
            .await;
        assert_eq!((answer.status, answer.json()), (200, empty), "{path}");
        let nowhere = service
            .get(&format!("/v1/routes/nowhere/map/layers/{path}"))
            .await;
        assert_eq!(nowhere.problem(), "unknown-route", "{path}");
    }
    for path in [
        "trajectories?max_points=99",
        "trajectories?max_points=50001",
        "residuals?limit=0",
        "residuals?limit=5001",
        "keyframes?limit=5",
    ] {
        let answer = service.get(&format!("{LAYERS}/{path}")).await;
        let found = (answer.status, answer.problem());
        assert_eq!(found, (400, "invalid-parameter".to_owned()), "{path}");
    }
    service.stop().await;
}
