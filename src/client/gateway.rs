//! A client of the service that repeats requests where that is safe.

mod answers;
mod keys;
mod maps;
mod probe;
mod retry;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use reqwest::header::{
    AUTHORIZATION, CONTENT_ENCODING, CONTENT_TYPE, HeaderMap, HeaderValue, InvalidHeaderValue,
};
use reqwest::{Method, StatusCode};
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::batch_body::EncodedBatch;
use crate::http_client;
use crate::ids::{BatchId, RouteId};
use crate::model::BatchKind;

use answers::AlertPage;
pub use answers::{AlertLocation, AlertReport, BatchReport, Refusal, RouteReport};
pub use keys::{KeyReport, KeyRequest};
pub use maps::{AlertDetail, NodeReport, ScanReport};
use retry::{is_temporary, retry_after, wait_before_repeat};

const CONTENT_DIGEST: &str = "content-digest";
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
const REQUEST_TIMEOUT: Duration = Duration::from_secs(60);
/// A request is given up once it has waited this long in all.
const WAIT_TOTAL_MAX: Duration = Duration::from_secs(900);

/// The outcome of an upload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Stored durably by this request.
    Stored,
    /// The same bytes were there already.
    Replayed,
}

/// Why a request failed for good.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// The key cannot be sent.
    #[error("the key is none: it has the form ms_…_…, as it was shown when it was made")]
    Key(#[source] InvalidHeaderValue),
    /// The client could not be built.
    #[error("the HTTP client could not be made")]
    Client(#[source] reqwest::Error),
    /// Nothing has ever answered at the address.
    #[error("nothing answers at {url}: is the service running there? (mapshift serve)")]
    Unreachable { url: String, source: reqwest::Error },
    /// The address is not valid.
    #[error("{url:?} is no address: give one like http://127.0.0.1:8080")]
    Url { url: String, source: reqwest::Error },
    /// The service refuses it for good.
    #[error("{what} was refused: {problem}")]
    Refused { what: String, problem: Box<Refusal> },
    /// The service could not accept it for a long time.
    #[error("{what} was given up after {waited_s} s of waiting; the last failure: {last}")]
    GivenUp {
        what: String,
        waited_s: u64,
        last: String,
    },
    /// The response does not match the API.
    #[error("the answer to {what} cannot be read: is {url} this service?")]
    Answer {
        what: String,
        url: String,
        source: serde_json::Error,
    },
}

struct Answer {
    status: StatusCode,
    headers: HeaderMap,
    body: Vec<u8>,
}

struct Request<'a> {
    method: Method,
    path: String,
    /// For people.
    what: String,
    body: Option<&'a [u8]>,
    gzip: bool,
}

/// A client of one service.
///
/// 408, 429, 5xx, resets, time-outs, and bodies that arrived damaged: the same bytes again after
/// `Retry-After`, else after 1 s × 2ⁿ up to 5 min, with jitter. Any other 4xx: never again.
pub struct Gateway {
    client: reqwest::Client,
    url: String,
    reached: Arc<AtomicBool>,
    notify: Box<dyn Fn(&str) + Send + Sync>,
}

impl Gateway {
    /// A client of the service at `url`, with a key if there is one; `notify` is called before every wait.
    pub fn new(
        url: &str,
        key: Option<&str>,
        notify: impl Fn(&str) + Send + Sync + 'static,
    ) -> Result<Self, GatewayError> {
        let url = url.trim_end_matches('/').to_owned();
        let mut builder = http_client::builder()
            .connect_timeout(CONNECT_TIMEOUT)
            .timeout(REQUEST_TIMEOUT);
        if let Some(key) = key {
            builder = builder.default_headers(key_header(key)?);
        }
        if is_loopback(&url) {
            builder = builder.no_proxy();
        }
        Ok(Self {
            client: builder.build().map_err(GatewayError::Client)?,
            url,
            reached: Arc::new(AtomicBool::new(false)),
            notify: Box::new(notify),
        })
    }

    /// The same client with another callback for waits.
    pub fn notifying(&self, notify: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self {
            client: self.client.clone(),
            url: self.url.clone(),
            reached: self.reached.clone(),
            notify: Box::new(notify),
        }
    }

    /// The URL of a route.
    pub fn route_url(&self, route: &RouteId) -> String {
        format!("{}/v1/routes/{route}", self.url)
    }

    /// Creates the route unless it exists; returns whether it was created. A key that may only upload cannot
    /// check, and assumes that it exists.
    pub async fn ensure_route(
        &self,
        route: &RouteId,
        display_name: Option<&str>,
    ) -> Result<bool, GatewayError> {
        match self.route(route).await {
            Ok(_) => Ok(false),
            Err(GatewayError::Refused { problem, .. }) if problem.status == 403 => Ok(false),
            Err(GatewayError::Refused { problem, .. }) if problem.status == 404 => {
                let fields = display_name.map(|name| ("display_name", name));
                let body = serde_json::Value::from_iter(fields).to_string();
                let answer = self
                    .send(Request {
                        method: Method::PUT,
                        path: format!("/v1/routes/{route}"),
                        what: format!("route {route}"),
                        body: Some(body.as_bytes()),
                        gzip: false,
                    })
                    .await?;
                Ok(answer.status == StatusCode::CREATED)
            }
            Err(error) => Err(error),
        }
    }

    /// Sends a batch until the service has it.
    pub async fn put_batch(
        &self,
        route: &RouteId,
        batch: &EncodedBatch,
    ) -> Result<Outcome, GatewayError> {
        let collection = match batch.kind {
            BatchKind::Scans => "batches",
            BatchKind::Edges => "edge-batches",
        };
        let answer = self
            .send(Request {
                method: Method::PUT,
                path: format!("/v1/routes/{route}/{collection}/{}", batch.id),
                what: format!("batch {}", batch.id),
                body: Some(&batch.gzip),
                gzip: true,
            })
            .await?;
        Ok(if answer.status == StatusCode::OK {
            Outcome::Replayed
        } else {
            Outcome::Stored
        })
    }

    /// The state of a route.
    pub async fn route(&self, route: &RouteId) -> Result<RouteReport, GatewayError> {
        self.get(format!("/v1/routes/{route}"), format!("route {route}"))
            .await
    }

    /// The state of a batch.
    pub async fn batch(
        &self,
        route: &RouteId,
        batch: &BatchId,
    ) -> Result<BatchReport, GatewayError> {
        let path = format!("/v1/routes/{route}/batches/{batch}");
        self.get(path, format!("batch {batch}")).await
    }

    /// A route's alerts; `None` if the service has no alerts.
    pub async fn alerts(&self, route: &RouteId) -> Result<Option<Vec<AlertReport>>, GatewayError> {
        let path = format!("/v1/alerts?route_id={route}&limit=1000");
        let mut alerts = Vec::new();
        let mut cursor = String::new();
        loop {
            let what = format!("the alerts of route {route}");
            let page: AlertPage = match self.get(format!("{path}{cursor}"), what).await {
                Ok(page) => page,
                Err(GatewayError::Refused { problem, .. }) if problem.status == 404 => {
                    return Ok(None);
                }
                Err(error) => return Err(error),
            };
            alerts.extend(page.items);
            match page.next_cursor {
                Some(next) => cursor = format!("&cursor={next}"),
                None => return Ok(Some(alerts)),
            }
        }
    }

    async fn get<T: DeserializeOwned>(
        &self,
        path: String,
        what: String,
    ) -> Result<T, GatewayError> {
        let body = self.get_bytes(path, what.clone()).await?;
        serde_json::from_slice(&body).map_err(|source| GatewayError::Answer {
            what,
            url: self.url.clone(),
            source,
        })
    }

    async fn get_bytes(&self, path: String, what: String) -> Result<Vec<u8>, GatewayError> {
        let request = Request {
            method: Method::GET,
            path,
            what,
            body: None,
            gzip: false,
        };
        Ok(self.send(request).await?.body)
    }

    async fn send(&self, request: Request<'_>) -> Result<Answer, GatewayError> {
        let mut waited = Duration::ZERO;
        let mut attempt = 0;
        loop {
            let (failure, retry_after) = match self.attempt(&request).await {
                Ok(answer) if answer.status.is_success() => return Ok(answer),
                Ok(answer) => {
                    let problem = Refusal::read(answer.status, &answer.body);
                    if !is_temporary(answer.status) && !problem.is_damage() {
                        let (what, problem) = (request.what, Box::new(problem));
                        return Err(GatewayError::Refused { what, problem });
                    }
                    (problem.to_string(), retry_after(&answer.headers))
                }
                Err(source) if source.is_builder() => {
                    let url = self.url.clone();
                    return Err(GatewayError::Url { url, source });
                }
                Err(source) if self.never_reached(&source) => {
                    let url = self.url.clone();
                    return Err(GatewayError::Unreachable { url, source });
                }
                Err(error) => (innermost(&error), None),
            };
            let wait = wait_before_repeat(attempt, retry_after, &request.path);
            if waited + wait > WAIT_TOTAL_MAX {
                return Err(GatewayError::GivenUp {
                    what: request.what,
                    waited_s: waited.as_secs(),
                    last: failure,
                });
            }
            (self.notify)(&format!(
                "{}: {failure}; again in {:.1} s",
                request.what,
                wait.as_secs_f64()
            ));
            tokio::time::sleep(wait).await;
            waited += wait;
            attempt += 1;
        }
    }

    async fn attempt(&self, request: &Request<'_>) -> Result<Answer, reqwest::Error> {
        let url = format!("{}{}", self.url, request.path);
        let mut builder = self.client.request(request.method.clone(), url);
        if let Some(body) = request.body {
            builder = builder
                .header(CONTENT_TYPE, "application/json")
                .header(CONTENT_DIGEST, content_digest(body))
                .body(body.to_vec());
        }
        if request.gzip {
            builder = builder.header(CONTENT_ENCODING, "gzip");
        }
        let response = builder.send().await?;
        self.reached.store(true, Ordering::Relaxed);
        Ok(Answer {
            status: response.status(),
            headers: response.headers().clone(),
            body: response.bytes().await?.into(),
        })
    }

    /// A wrong address is reported at once, a service that restarts is waited for.
    fn never_reached(&self, error: &reqwest::Error) -> bool {
        error.is_connect() && !self.reached.load(Ordering::Relaxed)
    }
}

/// The header of RFC 9530, by which the service detects damaged bytes.
fn content_digest(body: &[u8]) -> String {
    format!("sha-256=:{}:", STANDARD.encode(Sha256::digest(body)))
}

/// The header that authenticates every request.
fn key_header(key: &str) -> Result<HeaderMap, GatewayError> {
    let value = HeaderValue::try_from(format!("Bearer {}", key.trim()));
    let mut value = value.map_err(GatewayError::Key)?;
    value.set_sensitive(true);
    Ok(HeaderMap::from_iter([(AUTHORIZATION, value)]))
}

fn is_loopback(url: &str) -> bool {
    let host = reqwest::Url::parse(url).ok().and_then(|u| {
        let host = u.host_str()?;
        Some(host.trim_matches(['[', ']']).to_owned())
    });
    host.is_some_and(|host| {
        host == "localhost"
            || host
                .parse::<std::net::IpAddr>()
                .is_ok_and(|ip| ip.is_loopback())
    })
}

fn innermost(error: &reqwest::Error) -> String {
    let mut cause: &dyn std::error::Error = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}

#[cfg(test)]
mod tests;
