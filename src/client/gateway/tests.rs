use super::*;
use std::sync::Mutex;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpListener;

use crate::client::pretend::read_request;

/// Answers one connection after the other from a script; an empty answer is a reset. Gives
/// the address and the requests as they came.
async fn scripted(answers: &'static [&'static str]) -> (String, Arc<Mutex<Vec<Vec<u8>>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let requests = Arc::new(Mutex::new(Vec::new()));
    let seen = requests.clone();
    tokio::spawn(async move {
        for answer in answers {
            let (mut stream, _) = listener.accept().await.unwrap();
            let request = read_request(&mut stream).await.unwrap();
            seen.lock().unwrap().push(request);
            stream.write_all(answer.as_bytes()).await.unwrap();
        }
    });
    (url, requests)
}

fn batch() -> EncodedBatch {
    EncodedBatch {
        kind: crate::model::BatchKind::Scans,
        id: BatchId::new("t-00000").unwrap(),
        gzip: vec![0x1f, 0x8b, 1, 2, 3],
    }
}

fn route() -> RouteId {
    RouteId::new("line-4").unwrap()
}

const ACCEPTED: &str = "HTTP/1.1 202 Accepted\r\ncontent-length: 0\r\nconnection: close\r\n\r\n";
const REPLAYED: &str = "HTTP/1.1 200 OK\r\ncontent-length: 2\r\nconnection: close\r\n\r\n{}";
const BUSY: &str = "HTTP/1.1 503 Service Unavailable\r\nretry-after: 0\r\n\
    content-length: 0\r\nconnection: close\r\n\r\n";
const TOO_MANY: &str = "HTTP/1.1 429 Too Many Requests\r\nretry-after: 0\r\n\
    content-length: 0\r\nconnection: close\r\n\r\n";
const DAMAGED: &str = "HTTP/1.1 400 Bad Request\r\nretry-after: 0\r\nconnection: close\r\n\
    content-length: 36\r\n\r\n{\"type\":\"/problems/digest-mismatch\"}";
const REFUSED: &str = "HTTP/1.1 422 Unprocessable Entity\r\nconnection: close\r\n\
    content-length: 127\r\n\r\n\
    {\"title\":\"The scans fit no lidar\",\"detail\":\"did you send degrees?\",\
    \"errors\":[{\"pointer\":\"/lidar/angle_min\",\"detail\":\"-180.0\"}]}";

#[tokio::test]
async fn temporary_failures_are_repeated_with_the_same_bytes() {
    let (url, requests) = scripted(&[BUSY, TOO_MANY, ACCEPTED]).await;
    let reported = Arc::new(Mutex::new(Vec::new()));
    let tell = reported.clone();
    let gateway =
        Gateway::new(&url, None, move |t| tell.lock().unwrap().push(t.to_owned())).unwrap();
    let outcome = gateway.put_batch(&route(), &batch()).await.unwrap();
    assert_eq!(outcome, Outcome::Stored);
    assert_eq!(reported.lock().unwrap().len(), 2);
    let requests = requests.lock().unwrap();
    assert_eq!(requests.len(), 3);
    assert_eq!(requests[0], requests[2]);
    assert!(requests[0].starts_with(b"PUT /v1/routes/line-4/batches/t-00000 HTTP/1.1\r\n"));
    let text = String::from_utf8_lossy(&requests[0]).to_lowercase();
    assert!(text.contains("content-encoding: gzip") && text.contains("application/json"));
    assert!(requests[0].ends_with(&[0x1f, 0x8b, 1, 2, 3]));
}

#[tokio::test]
async fn a_body_that_was_damaged_on_its_way_is_sent_again() {
    let (url, requests) = scripted(&[DAMAGED, ACCEPTED]).await;
    let gateway = Gateway::new(&url, None, |_| ()).unwrap();
    let outcome = gateway.put_batch(&route(), &batch()).await.unwrap();
    assert_eq!(outcome, Outcome::Stored);
    let requests = requests.lock().unwrap();
    assert_eq!(requests.len(), 2);
    let digest = "content-digest: sha-256=:AOJaXGlwLGRcxW4hm0DeuMcFFI/sScEeyHXY4RvL36A=:";
    let text = String::from_utf8_lossy(&requests[0]);
    assert!(text.contains(digest), "{text}");
}

#[tokio::test]
async fn a_cut_connection_is_repeated_and_a_replay_is_reported() {
    let (url, requests) = scripted(&["", REPLAYED]).await;
    let gateway = Gateway::new(&url, None, |_| ()).unwrap();
    let outcome = gateway.put_batch(&route(), &batch()).await.unwrap();
    assert_eq!(outcome, Outcome::Replayed);
    assert_eq!(requests.lock().unwrap().len(), 2);
}

#[tokio::test]
async fn a_refusal_is_final_and_in_the_services_words() {
    let (url, requests) = scripted(&[REFUSED, ACCEPTED]).await;
    let gateway = Gateway::new(&url, None, |_| ()).unwrap();
    let error = gateway.put_batch(&route(), &batch()).await.unwrap_err();
    assert_eq!(
        error.to_string(),
        "batch t-00000 was refused: 422 The scans fit no lidar: did you send degrees? \
         [at /lidar/angle_min: -180.0]"
    );
    assert_eq!(requests.lock().unwrap().len(), 1);
}

#[tokio::test]
async fn a_wrong_address_is_reported_at_once() {
    let free = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", free.local_addr().unwrap());
    drop(free);
    let gateway = Gateway::new(&url, None, |_| ()).unwrap();
    let error = gateway.route(&route()).await.unwrap_err();
    assert!(
        matches!(error, GatewayError::Unreachable { .. }),
        "{error:?}"
    );
    let gateway = Gateway::new("nonsense", None, |_| ()).unwrap();
    let error = gateway.route(&route()).await.unwrap_err();
    assert!(matches!(error, GatewayError::Url { .. }), "{error:?}");
}

#[test]
fn only_loopback_goes_round_a_proxy() {
    for url in [
        "http://127.0.0.1:8080",
        "http://localhost",
        "http://[::1]:9",
    ] {
        assert!(is_loopback(url), "{url}");
    }
    for url in ["http://10.0.0.4:8080", "https://example.org", "nonsense"] {
        assert!(!is_loopback(url), "{url}");
    }
}
