//! Uploads: stored once, however they come.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::json;
use sha2::{Digest, Sha256};

use crate::body::{batch, batch_with, gzip, zstd};
use crate::client::Request;
use crate::service::Service;

const PATH: &str = "/v1/routes/line-4/batches/b-1";

fn put(body: impl Into<Vec<u8>>) -> Request {
    Request::new("PUT", PATH)
        .header("content-type", "application/json")
        .body(body)
}

#[tokio::test]
async fn the_same_bytes_are_stored_once_and_other_bytes_never() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let plain = batch(0, 3).to_string();
    let stored = service.send(put(plain.clone())).await;
    assert_eq!(stored.status, 202);
    assert_eq!(stored.header("location"), Some(PATH));
    assert_eq!(stored.header("idempotent-replayed"), None);
    let body = stored.json();
    assert_eq!(body["scans"], 3);
    assert_eq!(body["alerts"], json!([]));
    assert_eq!(body["vehicle_id"], "agv-07");

    for encoded in [
        put(plain.clone()),
        put(gzip(plain.as_bytes())).header("content-encoding", "gzip"),
        put(zstd(plain.as_bytes())).header("content-encoding", "zstd"),
    ] {
        let replayed = service.send(encoded).await;
        assert_eq!(replayed.status, 200);
        assert_eq!(replayed.header("idempotent-replayed"), Some("true"));
        assert_eq!(replayed.json()["received_at"], body["received_at"]);
    }
    let other = service.send(put(batch(0, 4).to_string())).await;
    assert_eq!(
        (other.status, other.problem().as_str()),
        (409, "batch-id-reused")
    );
    let route = service.get("/v1/routes/line-4").await.json();
    assert_eq!(route["counts"]["batches"], 1);
    assert_eq!(route["counts"]["scans"], 3);
    service.stop().await;
}

#[tokio::test]
async fn compressed_and_chunked_uploads_are_accepted() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let packed = zstd(batch(0, 3).to_string().as_bytes());
    let first = put(packed).header("content-encoding", "zstd");
    assert_eq!(service.send(first).await.status, 202);
    let plain = batch(1, 2).to_string();
    let mut chunked = Request::new("PUT", "/v1/routes/line-4/batches/b-2")
        .header("content-type", "application/json")
        .header("transfer-encoding", "chunked")
        .header("content-length", "");
    chunked.headers.pop();
    let (one, two) = plain.split_at(plain.len() / 2);
    let mut connection = crate::client::Connection::open(service.address).await;
    connection.write(&chunked.head()).await;
    let chunks = format!(
        "{:x}\r\n{one}\r\n{:x}\r\n{two}\r\n0\r\n\r\n",
        one.len(),
        two.len()
    );
    connection.write(chunks.as_bytes()).await;
    assert_eq!(connection.answer().await.status, 202);
    service.stop().await;
}

#[tokio::test]
async fn a_stated_digest_is_checked() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let packed = gzip(batch(0, 3).to_string().as_bytes());
    let wrong = put(packed.clone())
        .header("content-encoding", "gzip")
        .header(
            "content-digest",
            "sha-256=:AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA=:",
        );
    assert_eq!(service.send(wrong).await.problem(), "digest-mismatch");
    let digest = format!("sha-256=:{}:", STANDARD.encode(Sha256::digest(&packed)));
    let right = put(packed)
        .header("content-encoding", "gzip")
        .header("content-digest", &digest);
    assert_eq!(service.send(right).await.status, 202);
    service.stop().await;
}

#[tokio::test]
async fn a_body_is_continued_only_if_it_will_be_accepted() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let plain = batch(0, 1).to_string();
    let mut connection = crate::client::Connection::open(service.address).await;
    connection
        .write(&put(plain.clone()).header("expect", "100-continue").head())
        .await;
    connection.write(plain.as_bytes()).await;
    let bytes = connection.rest().await;
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.starts_with("HTTP/1.1 100 "), "{text}");
    assert!(text.contains("HTTP/1.1 202 "), "{text}");
    let refused = Request::new("PUT", "/v1/routes/nowhere/batches/b")
        .header("content-type", "application/json")
        .header("content-length", "100000")
        .header("expect", "100-continue");
    assert_eq!(service.send(refused).await.problem(), "unknown-route");
    service.stop().await;
}

#[tokio::test]
async fn request_ids_are_echoed_or_generated() {
    let service = Service::start().await;
    let given = Request::new("GET", "/livez").header("x-request-id", "gateway-7/42");
    assert_eq!(
        service.send(given).await.header("x-request-id"),
        Some("gateway-7/42")
    );
    for bad in ["a b", "<script>", &"x".repeat(200)] {
        let answer = service
            .send(Request::new("GET", "/livez").header("x-request-id", bad))
            .await;
        assert_eq!(answer.header("x-request-id").unwrap().len(), 36);
    }
    service.stop().await;
}

#[tokio::test]
async fn the_status_of_many_batches_is_one_request() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    for k in 0..5 {
        let path = format!("/v1/routes/line-4/batches/b-{k}");
        let put = Request::new("PUT", path).json(&batch(k, 1));
        assert_eq!(service.send(put).await.status, 202);
    }
    let ids = async |query: &str| {
        let path = format!("/v1/routes/line-4/batches?{query}");
        let list = service.get(&path).await.json();
        let items = list["items"].as_array().unwrap().iter();
        let ids: Vec<String> = items
            .map(|batch| batch["id"].as_str().unwrap().to_owned())
            .collect();
        ids
    };
    assert_eq!(ids("ids=b-3,nobody,b-1").await, ["b-1", "b-3"]);
    assert_eq!(ids("ids=b-1%2Cb-3&limit=1").await, ["b-1"]);
    assert_eq!(ids("ids=b-1&vehicle_id=agv-08").await, [""; 0]);

    let many = |count: usize| {
        let ids: Vec<String> = (0..count).map(|k| format!("b-{k}")).collect();
        format!("/v1/routes/line-4/batches?ids={}", ids.join(","))
    };
    let all = service.get(&many(200)).await.json();
    assert_eq!(all["items"].as_array().unwrap().len(), 5);
    assert_eq!(all["next_cursor"], json!(null));
    for (path, word) in [
        (many(201), "at most 200"),
        ("/v1/routes/line-4/batches?ids=".to_owned(), "ids"),
        ("/v1/routes/line-4/batches?ids=a,,b".to_owned(), "ids"),
        ("/v1/routes/line-4/batches?ids=a/b".to_owned(), "ids"),
    ] {
        let refused = service.get(&path).await;
        assert_eq!(refused.status, 400, "{path}");
        assert!(refused.text().contains(word), "{}", refused.text());
    }
    service.stop().await;
}

#[tokio::test]
async fn readings_of_real_drivers_are_accepted_flagged_and_counted() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let mut body = batch(0, 2);
    // Clockwise, with an error code, a zero, and two ways to say that there was no return.
    body["lidar"]["angle_min"] = json!(2.46);
    body["lidar"]["angle_increment"] = json!(-0.78);
    body["lidar"]["time_increment"] = json!(0.001);
    body["scans"][0]["ranges"] = json!([-0.003, 0, 2.2, null, 3.4e38, 20.0, 2.6, 2.7]);
    body["scans"][0]["stamp"] = json!("1970-01-01T00:00:01Z");
    body["scans"][1]["stamp"] = json!("1970-01-01T00:00:02Z");
    let stored = service.send(put(body.to_string())).await;
    assert_eq!(stored.status, 202, "{}", stored.json());
    let flags = [
        "above_range_max",
        "below_range_min",
        "clockwise_scans",
        "simulated_time",
    ];
    for answered in [stored.json(), service.get(PATH).await.json()] {
        assert_eq!(answered["flags"], json!(flags));
        let counted = json!({"above_range_max": 2, "below_range_min": 2});
        assert_eq!(answered["out_of_range"], counted);
        assert_eq!(answered["extensions"], json!(null));
    }
    service.stop().await;
}

#[tokio::test]
async fn extensions_are_returned_as_they_were_sent() {
    let service = Service::start().await;
    service.put_route("line-4").await;
    let extensions = json!({"firmware": "4.2.1", "nested": [{"ü": null}]});
    let scans = batch_with("/extensions", extensions.clone());
    assert_eq!(service.send(put(scans.to_string())).await.status, 202);
    let node = json!({"id": 0, "pose": {"x": 0.0, "y": 0.0, "theta": 0.0}});
    let edges =
        json!({"vehicle_id": "agv-08", "nodes": [node], "edges": [], "extensions": extensions});
    let path = "/v1/routes/line-4/edge-batches/e-1";
    let stored = service.send(Request::new("PUT", path).json(&edges)).await;
    assert_eq!(stored.status, 202, "{}", stored.json());
    assert_eq!(stored.json()["out_of_range"], json!(null));
    for path in [PATH, "/v1/routes/line-4/batches/e-1"] {
        assert_eq!(service.get(path).await.json()["extensions"], extensions);
    }
    let list = service.get("/v1/routes/line-4/batches").await.json();
    assert_eq!(list["items"][0]["extensions"], extensions);
    service.stop().await;
}
