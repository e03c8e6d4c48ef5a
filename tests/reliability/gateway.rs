//! A gateway that tells what it was answered, and remembers what was acknowledged.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use reqwest::header::{CONNECTION, HeaderMap, HeaderValue};
use sha2::{Digest, Sha256};

use crate::drives::Batch;

/// An answer later than this is none.
const PATIENCE: Duration = Duration::from_secs(30);

/// A sender of uploads to one service.
#[derive(Clone)]
pub struct Gateway {
    http: reqwest::Client,
    url: String,
}

/// What an upload was answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer {
    pub status: u16,
    /// `Idempotent-Replayed: true`.
    pub is_replay: bool,
    pub retry_after_s: Option<u64>,
}

impl Answer {
    /// The gateway may forget the batch.
    pub fn is_acknowledgement(&self) -> bool {
        [200, 202].contains(&self.status)
    }
}

impl Gateway {
    pub fn new(url: &str) -> Self {
        Self::of(url, builder())
    }

    /// Comes from one of this machine's addresses, like 127.0.0.2.
    pub fn from_address(url: &str, address: IpAddr) -> Self {
        Self::of(url, builder().local_address(address))
    }

    /// Opens a connection for each request and asks for its end.
    pub fn of_one_request_each(url: &str) -> Self {
        let close = (CONNECTION, HeaderValue::from_static("close"));
        let builder = builder().default_headers(HeaderMap::from_iter([close]));
        Self::of(url, builder.pool_max_idle_per_host(0))
    }

    fn of(url: &str, builder: reqwest::ClientBuilder) -> Self {
        Self {
            http: builder.build().unwrap(),
            url: url.to_owned(),
        }
    }

    /// Sends a batch once; an error is a connection that broke.
    pub async fn put(&self, route: &str, batch: &Batch) -> reqwest::Result<Answer> {
        self.send(self.request(route, batch)).await
    }

    /// Sends a batch whose body is compressed so.
    pub async fn put_encoded(
        &self,
        route: &str,
        batch: &Batch,
        encoding: &str,
    ) -> reqwest::Result<Answer> {
        let request = self.request(route, batch);
        self.send(request.header("content-encoding", encoding))
            .await
    }

    fn request(&self, route: &str, batch: &Batch) -> reqwest::RequestBuilder {
        let url = format!("{}/v1/routes/{route}/batches/{}", self.url, batch.id);
        let digest = STANDARD.encode(Sha256::digest(&batch.body));
        let request = self.http.put(url).body(batch.body.clone());
        request
            .header("content-type", "application/json")
            .header("content-digest", format!("sha-256=:{digest}:"))
    }

    async fn send(&self, request: reqwest::RequestBuilder) -> reqwest::Result<Answer> {
        let answer = request.send().await?;
        let header = |name: &str| answer.headers().get(name)?.to_str().ok();
        let answered = Answer {
            status: answer.status().as_u16(),
            is_replay: header("idempotent-replayed") == Some("true"),
            retry_after_s: header("retry-after").and_then(|text| text.parse().ok()),
        };
        // An acknowledgement counts when it is there whole.
        answer.bytes().await?;
        Ok(answered)
    }

    /// The status of a read; an error is a connection that broke.
    pub async fn get(&self, path: &str) -> reqwest::Result<u16> {
        let answer = self.http.get(format!("{}{path}", self.url)).send().await?;
        Ok(answer.status().as_u16())
    }

    pub async fn delete(&self, path: &str) -> reqwest::Result<u16> {
        let request = self.http.delete(format!("{}{path}", self.url));
        Ok(request.send().await?.status().as_u16())
    }
}

fn builder() -> reqwest::ClientBuilder {
    mapshift::http_client::builder()
        .no_proxy()
        .timeout(PATIENCE)
}

/// Where a service listens, from its URL.
pub fn address_of(url: &str) -> SocketAddr {
    url.strip_prefix("http://").unwrap().parse().unwrap()
}

/// What was acknowledged, by route and id: what may never be missing again.
#[derive(Debug, Clone, Default)]
pub struct Acknowledged(BTreeMap<(String, String), Batch>);

impl Acknowledged {
    pub fn note(&mut self, route: &str, batch: &Batch) {
        self.0
            .insert((route.to_owned(), batch.id.clone()), batch.clone());
    }

    pub fn note_all(&mut self, other: Self) {
        self.0.extend(other.0);
    }

    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Routes and batches.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Batch)> {
        self.0
            .iter()
            .map(|((route, _), batch)| (route.as_str(), batch))
    }

    /// Every route of which something was acknowledged, once.
    pub fn routes(&self) -> Vec<String> {
        let mut routes: Vec<String> = self.0.keys().map(|(route, _)| route.clone()).collect();
        routes.dedup();
        routes
    }
}
