//! A gateway as simple as can be, and a reader of what the service tells.

use std::time::{Duration, Instant};

use reqwest::StatusCode;
use reqwest::header::{HeaderMap, HeaderName, HeaderValue};
use serde_json::{Value, json};

use crate::drives::Batch;

/// What is not settled by then is stuck, and the test fails.
const PATIENCE: Duration = Duration::from_secs(120);
pub const POLL: Duration = Duration::from_millis(20);

/// A client of one service.
#[derive(Clone)]
pub struct Client {
    http: reqwest::Client,
    url: String,
}

/// What became of an upload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Put {
    /// 202.
    Stored,
    /// 200 with `Idempotent-Replayed: true`.
    Replayed,
}

impl Client {
    pub fn new(url: &str) -> Self {
        let http = mapshift::http_client::builder().no_proxy().build().unwrap();
        Self {
            http,
            url: url.to_owned(),
        }
    }

    /// Of somebody whom a proxy has signed in, as a member of `keepers`.
    pub fn signed_in(url: &str, name: &str) -> Self {
        let headers = [
            ("x-forwarded-user", name),
            ("x-forwarded-groups", "keepers"),
        ];
        let headers = headers.map(|(header, value)| {
            (
                HeaderName::from_static(header),
                HeaderValue::from_str(value).unwrap(),
            )
        });
        let builder = mapshift::http_client::builder().no_proxy();
        let builder = builder.default_headers(HeaderMap::from_iter(headers));
        Self {
            http: builder.build().unwrap(),
            url: url.to_owned(),
        }
    }

    pub async fn put_route(&self, route: &str, settings: Value) {
        let url = format!("{}/v1/routes/{route}", self.url);
        let body = json!({ "settings": settings });
        let answer = self.http.put(url).json(&body).send().await.unwrap();
        assert!(answer.status().is_success(), "{answer:?}");
    }

    /// The status and the problem that a change of settings is refused with.
    pub async fn route_refusal(&self, route: &str, settings: Value) -> (u16, Value) {
        let url = format!("{}/v1/routes/{route}", self.url);
        let body = json!({ "settings": settings });
        let answer = self.http.put(url).json(&body).send().await.unwrap();
        (answer.status().as_u16(), answer.json().await.unwrap())
    }

    /// Sends a batch once; an error is a connection that broke.
    pub async fn try_put(&self, route: &str, batch: &Batch) -> reqwest::Result<Put> {
        let url = format!("{}/v1/routes/{route}/batches/{}", self.url, batch.id);
        let request = self.http.put(url).body(batch.body.clone());
        let request = request.header("content-type", "application/json");
        let answer = request.send().await?;
        let replayed = answer.headers().get("idempotent-replayed");
        match (answer.status(), replayed.map(|v| v.as_bytes())) {
            (StatusCode::ACCEPTED, None) => Ok(Put::Stored),
            (StatusCode::OK, Some(b"true")) => Ok(Put::Replayed),
            (status, replayed) => panic!("{} got {status}, replayed {replayed:?}", batch.id),
        }
    }

    pub async fn put(&self, route: &str, batch: &Batch) -> Put {
        self.try_put(route, batch).await.unwrap()
    }

    pub async fn put_all<'a>(&self, route: &str, batches: impl IntoIterator<Item = &'a Batch>) {
        for batch in batches {
            self.put(route, batch).await;
        }
    }

    /// Sends a batch of edges once; the status and the answer.
    pub async fn put_edges(&self, route: &str, id: &str, batch: &Value) -> (u16, Value) {
        let url = format!("{}/v1/routes/{route}/edge-batches/{id}", self.url);
        let answer = self.http.put(url).json(batch).send().await.unwrap();
        (answer.status().as_u16(), answer.json().await.unwrap())
    }

    /// Puts a body; the status and the answer.
    pub async fn put_body(&self, path: String, body: &Value) -> (u16, Value) {
        let answer = self
            .http
            .put(format!("{}{path}", self.url))
            .json(body)
            .send()
            .await
            .unwrap();
        (answer.status().as_u16(), answer.json().await.unwrap())
    }

    /// Asks for a removal and waits for its end; hands back the operation.
    pub async fn remove(&self, route: &str, what: Value) -> Value {
        let url = format!("{}/v1/routes/{route}/removals", self.url);
        let answer = self.http.post(url).json(&what).send().await.unwrap();
        assert_eq!(answer.status(), StatusCode::ACCEPTED, "{what}");
        let at = answer.headers()["location"].to_str().unwrap().to_owned();
        self.ended_operation(&at).await
    }

    /// An operation once it has ended, by its path.
    pub async fn ended_operation(&self, operation: &str) -> Value {
        let give_up = Instant::now() + PATIENCE;
        loop {
            let operation = self.json(operation).await;
            if operation["status"] != "queued" {
                return operation;
            }
            assert!(Instant::now() < give_up, "{operation}");
            tokio::time::sleep(POLL).await;
        }
    }

    /// Asks for another try of a batch; the status and the answer.
    pub async fn retry(&self, route: &str, batch: &str) -> (u16, Value) {
        let url = format!("{}/v1/routes/{route}/batches/{batch}/retry", self.url);
        let answer = self.http.post(url).send().await.unwrap();
        (answer.status().as_u16(), answer.json().await.unwrap())
    }

    /// Posts; the status and the answer.
    pub async fn post(&self, path: String, body: Value) -> (u16, Value) {
        let request = self.http.post(format!("{}{path}", self.url));
        let request = match body {
            Value::Null => request,
            body => request.json(&body),
        };
        let answer = request.send().await.unwrap();
        (answer.status().as_u16(), answer.json().await.unwrap())
    }

    /// Deletes; the status.
    pub async fn delete(&self, path: &str) -> StatusCode {
        let request = self.http.delete(format!("{}{path}", self.url));
        request.send().await.unwrap().status()
    }

    /// A batch once nobody works on it.
    pub async fn ended(&self, route: &str, id: &str) -> Value {
        let give_up = Instant::now() + PATIENCE;
        loop {
            let batch = self.batch(route, id).await;
            if !["queued", "processing"].contains(&batch["status"].as_str().unwrap()) {
                return batch;
            }
            assert!(Instant::now() < give_up, "{batch}");
            tokio::time::sleep(POLL).await;
        }
    }

    /// The status and the JSON of anything.
    pub async fn get_any(&self, path: &str) -> (u16, Value) {
        let url = format!("{}{path}", self.url);
        let answer = self.http.get(url).send().await.unwrap();
        (answer.status().as_u16(), answer.json().await.unwrap())
    }

    pub async fn status_of(&self, path: &str) -> StatusCode {
        let url = format!("{}{path}", self.url);
        self.http.get(url).send().await.unwrap().status()
    }

    pub async fn bytes(&self, path: &str) -> Vec<u8> {
        let url = format!("{}{path}", self.url);
        let answer = self.http.get(url).send().await.unwrap();
        assert_eq!(answer.status(), StatusCode::OK, "{path}");
        answer.bytes().await.unwrap().into()
    }

    pub async fn text(&self, path: &str) -> String {
        String::from_utf8(self.bytes(path).await).unwrap()
    }

    pub async fn json(&self, path: &str) -> Value {
        serde_json::from_slice(&self.bytes(path).await).unwrap()
    }

    /// Does something with an alert that is at the revision at hand; hands it back as it is then.
    pub async fn decide(&self, alert: &Value, action: &str) -> Value {
        let id = alert["id"].as_str().unwrap();
        let url = format!("{}/v1/alerts/{id}/{action}", self.url);
        let request = self.http.post(url).json(&json!({"by": "A. Keeper"}));
        let request = request.header("if-match", format!("\"{}\"", alert["decision_revision"]));
        let answer = request.send().await.unwrap();
        assert_eq!(answer.status(), StatusCode::OK, "{action} {alert}");
        answer.json().await.unwrap()
    }

    pub async fn register_webhook(&self, body: Value) -> Value {
        let url = format!("{}/v1/webhooks", self.url);
        let answer = self.http.post(url).json(&body).send().await.unwrap();
        assert_eq!(answer.status(), StatusCode::CREATED, "{body}");
        answer.json().await.unwrap()
    }

    /// Every item of a list, read in parts of `limit`.
    pub async fn list(&self, path: &str, limit: usize) -> Vec<Value> {
        let mut items = Vec::new();
        let mut cursor = String::new();
        loop {
            let page = self.json(&format!("{path}?limit={limit}{cursor}")).await;
            items.extend(page["items"].as_array().unwrap().iter().cloned());
            match page["next_cursor"].as_str() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => return items,
            }
        }
    }

    pub async fn route(&self, route: &str) -> Value {
        self.json(&format!("/v1/routes/{route}")).await
    }

    pub async fn batch(&self, route: &str, id: &str) -> Value {
        self.json(&format!("/v1/routes/{route}/batches/{id}")).await
    }

    /// Waits until nothing is queued or under way, and hands back every batch. Held batches are
    /// waited for as well where `held` says so.
    pub async fn settled(&self, route: &str, held: bool) -> Vec<Value> {
        let give_up = Instant::now() + PATIENCE;
        loop {
            let pending = self.route(route).await["pending_batches"].as_i64().unwrap();
            if pending == 0 {
                let batches = self.list(&format!("/v1/routes/{route}/batches"), 50).await;
                let is = |batch: &Value, status: &str| batch["status"] == status;
                let waits =
                    |b: &&Value| is(b, "queued") || is(b, "processing") || (held && is(b, "held"));
                if !batches.iter().any(|b| waits(&b)) {
                    return batches;
                }
            }
            assert!(Instant::now() < give_up, "{route}: {pending} batches stuck");
            tokio::time::sleep(POLL).await;
        }
    }

    /// Waits until everything sent so far is in the map.
    pub async fn merged(&self, route: &str) -> Vec<Value> {
        let batches = self.settled(route, true).await;
        for batch in &batches {
            assert_eq!(batch["status"], "merged", "{batch}");
        }
        batches
    }
}
