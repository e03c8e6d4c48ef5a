//! A fake service for the tests of clients.

use std::collections::BTreeMap;
use std::io::Read;
use std::sync::{Arc, Mutex};

use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

/// Injected faults.
#[derive(Debug, Clone, Copy, Default)]
pub struct Faults {
    /// Every n-th request is answered 503; 0 for none.
    pub busy_every: usize,
    /// Batches of this vehicle are never localised.
    pub unanchored: Option<&'static str>,
}

/// What it received.
#[derive(Debug, Default)]
pub struct State {
    pub routes_made: usize,
    /// By id.
    pub batches: BTreeMap<String, Value>,
    pub replays: usize,
    /// One page each; `None` for a service without alerts.
    pub alerts: Option<Vec<Value>>,
    requests: usize,
}

pub struct Pretend {
    pub url: String,
    pub state: Arc<Mutex<State>>,
}

impl Pretend {
    pub async fn start(faults: Faults) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let state = Arc::new(Mutex::new(State::default()));
        let shared = state.clone();
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = listener.accept().await {
                let state = shared.clone();
                tokio::spawn(async move {
                    while let Some(request) = read_request(&mut stream).await {
                        let (status, body) = state.lock().unwrap().answer(&request, &faults);
                        let body = body.to_string();
                        let answer = format!(
                            "HTTP/1.1 {status} x\r\nretry-after: 0\r\ncontent-length: {}\r\n\r\n{body}",
                            body.len()
                        );
                        stream.write_all(answer.as_bytes()).await.unwrap();
                    }
                });
            }
        });
        Self { url, state }
    }
}

impl State {
    fn answer(&mut self, request: &[u8], faults: &Faults) -> (u16, Value) {
        self.requests += 1;
        if faults.busy_every > 0 && self.requests.is_multiple_of(faults.busy_every) {
            return (503, json!({"title": "busy"}));
        }
        let head_end = head_length(request).unwrap();
        let line = String::from_utf8_lossy(request)
            .lines()
            .next()
            .unwrap()
            .to_owned();
        let words: Vec<&str> = line.split(' ').collect();
        if let Some(query) = words[1].strip_prefix("/v1/alerts?") {
            return self.alert_page(query);
        }
        let path: Vec<&str> = words[1].split('/').skip(3).collect();
        match (words[0], path.as_slice()) {
            ("PUT", [_]) => {
                self.routes_made += 1;
                (201, json!({}))
            }
            ("GET", [_]) if self.routes_made == 0 => (404, json!({"title": "no such route"})),
            ("GET", [_]) => (200, route_json()),
            ("PUT", [_, "batches" | "edge-batches", id]) => {
                self.put_batch(id, &request[head_end..])
            }
            ("GET", [_, "batches", id]) if self.batches.contains_key(*id) => {
                let vehicle = &self.batches[*id]["vehicle_id"];
                let lost = faults.unanchored.is_some_and(|v| vehicle == v);
                (200, batch_json(lost))
            }
            _ => (404, json!({"title": "nothing here"})),
        }
    }

    fn alert_page(&self, query: &str) -> (u16, Value) {
        let Some(alerts) = &self.alerts else {
            return (404, json!({"title": "no such thing"}));
        };
        let cursor = query
            .split_once("&cursor=")
            .map_or("0", |(_, cursor)| cursor);
        let first: usize = cursor.parse().unwrap();
        let items: Vec<&Value> = alerts.iter().skip(first).take(1).collect();
        let next = (first + 1 < alerts.len()).then(|| (first + 1).to_string());
        (200, json!({"items": items, "next_cursor": next}))
    }

    fn put_batch(&mut self, id: &str, body: &[u8]) -> (u16, Value) {
        let mut text = String::new();
        let mut decoder = flate2::read::GzDecoder::new(body);
        decoder.read_to_string(&mut text).unwrap();
        let body: Value = serde_json::from_str(&text).unwrap();
        match self.batches.get(id) {
            None => {
                self.batches.insert(id.to_owned(), body);
                (202, json!({}))
            }
            Some(stored) if *stored == body => {
                self.replays += 1;
                (200, json!({}))
            }
            Some(_) => (
                409,
                json!({"title": "The batch id is taken by other bytes"}),
            ),
        }
    }
}

fn route_json() -> Value {
    let counts = json!({"nodes": 1, "edges": 2, "loop_closures": 3});
    json!({"stage": "mapping", "map_version": 1, "counts": counts, "pending_batches": 0})
}

fn batch_json(lost: bool) -> Value {
    let (status, reason) = if lost {
        ("unanchored", Some("not recognised"))
    } else {
        ("merged", None)
    };
    json!({"status": status, "reason": reason, "nodes_added": 4, "loop_closures": 1})
}

/// Reads one request with its body; `None` once the client is gone.
pub async fn read_request(stream: &mut TcpStream) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut chunk = [0; 4096];
    loop {
        if let Some(head_end) = head_length(&bytes) {
            let head = String::from_utf8_lossy(&bytes[..head_end]).to_lowercase();
            let length = head
                .lines()
                .find_map(|l| l.strip_prefix("content-length: ")?.parse().ok())
                .unwrap_or(0);
            if bytes.len() >= head_end + length {
                return Some(bytes);
            }
        }
        match stream.read(&mut chunk).await {
            Ok(read) if read > 0 => bytes.extend_from_slice(&chunk[..read]),
            _ => return None,
        }
    }
}

fn head_length(bytes: &[u8]) -> Option<usize> {
    let end = bytes.windows(4).position(|w| w == b"\r\n\r\n")?;
    Some(end + 4)
}
