//! The vehicles of a route.

use serde_json::{Value, json};

use crate::service::Service;

#[tokio::test]
async fn a_vehicle_is_shown_with_its_uploads() {
    let service = Service::start_with_map().await;
    let page = service.get("/v1/routes/hall/vehicles").await.json();
    let items = page["items"].as_array().unwrap();
    assert_eq!(items.len(), 1);
    let vehicle = &items[0];
    assert_eq!(vehicle["id"], "agv-07");
    assert_eq!(vehicle["state"], "trusted");
    assert_eq!(vehicle["reasons"], json!([]));
    let route = service.get("/v1/routes/hall").await.json();
    assert_eq!(vehicle["counts"]["batches"], route["counts"]["batches"]);
    assert_eq!(vehicle["counts"]["scans"], route["counts"]["scans"]);
    // Too few scans to say anything of its lidar.
    assert_eq!(vehicle["calibration"]["trips"], 0);
    for field in [
        "yaw",
        "offset_x",
        "way_scale",
        "clock",
        "beam_spacing",
        "range_scale",
    ] {
        assert_eq!(vehicle["calibration"][field], Value::Null, "{field}");
    }
    let alone = service.get("/v1/routes/hall/vehicles/agv-07").await.json();
    assert_eq!(&alone, vehicle);
}

#[tokio::test]
async fn vehicles_are_listed_in_pages_by_name() {
    let service = Service::start_with_map().await;
    let page = service.get("/v1/routes/hall/vehicles?limit=1").await.json();
    assert_eq!(page["items"].as_array().unwrap().len(), 1);
    assert_eq!(page["next_cursor"], Value::Null);
    for (path, status, kind) in [
        ("/v1/routes/hall/vehicles/agv-99", 404, "not-found"),
        ("/v1/routes/nowhere/vehicles", 404, "unknown-route"),
        ("/v1/routes/nowhere/vehicles/agv-07", 404, "unknown-route"),
        ("/v1/routes/hall/vehicles?limit=0", 400, "invalid-parameter"),
        (
            "/v1/routes/hall/vehicles?cursor=zz",
            400,
            "invalid-parameter",
        ),
    ] {
        let answer = service.get(path).await;
        assert_eq!(answer.status, status, "{path}");
        let problem = answer.json();
        assert!(
            problem["type"].as_str().unwrap().ends_with(kind),
            "{path}: {problem}"
        );
    }
}
