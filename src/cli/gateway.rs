//! A client of the service that repeats what may be repeated.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use reqwest::header::{CONTENT_ENCODING, CONTENT_TYPE, HeaderMap, RETRY_AFTER};
use reqwest::{Method, StatusCode};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::batch_body::EncodedBatch;
use crate::ids::{BatchId, RouteId};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
const REQUEST_TIMEOUT: Duration = Duration::from_secs(60);
/// First wait before a repeat; each further one is twice as long …
const WAIT_FIRST: Duration = Duration::from_secs(1);
/// … up to this.
const WAIT_MAX: Duration = Duration::from_secs(300);
/// A request is given up once it has waited this long in all.
const WAIT_TOTAL_MAX: Duration = Duration::from_secs(900);

/// What became of an upload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    /// Stored durably by this request.
    Stored,
    /// The same bytes were there already.
    Replayed,
}

/// What the service says about a route.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct RouteReport {
    pub stage: String,
    pub map_version: i64,
    pub counts: RouteCounts,
    pub pending_batches: i64,
}

/// What a route holds.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct RouteCounts {
    pub nodes: i64,
    pub edges: i64,
    pub loop_closures: i64,
}

/// What the service says about a batch.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct BatchReport {
    pub status: String,
    pub reason: Option<String>,
    pub nodes_added: i64,
    pub loop_closures: i64,
}

impl BatchReport {
    /// Whether the service still means to work on it without being asked.
    pub(super) fn is_under_way(&self) -> bool {
        matches!(self.status.as_str(), "queued" | "processing" | "held")
    }
}

/// Why a request failed for good.
#[derive(Debug, thiserror::Error)]
pub(super) enum GatewayError {
    /// The client could not be made.
    #[error("the HTTP client could not be made")]
    Client(#[source] reqwest::Error),
    /// Nothing answered at the address, ever.
    #[error("nothing answers at {url}: is the service running there? (mapshift serve)")]
    Unreachable { url: String, source: reqwest::Error },
    /// The address is no address.
    #[error("{url:?} is no address: give one like http://127.0.0.1:8080")]
    Url { url: String, source: reqwest::Error },
    /// The service will not take it, however often it is sent.
    #[error("{what} was refused: {problem}")]
    Refused { what: String, problem: Refusal },
    /// The service could not take it for a long time.
    #[error("{what} was given up after {waited_s} s of waiting; the last failure: {last}")]
    GivenUp {
        what: String,
        waited_s: u64,
        last: String,
    },
    /// The answer is not what the interface promises.
    #[error("the answer to {what} cannot be read: is {url} this service?")]
    Answer {
        what: String,
        url: String,
        source: serde_json::Error,
    },
}

/// A refusal in the service's own words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Refusal {
    pub status: u16,
    problem: Problem,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
struct Problem {
    title: String,
    detail: String,
    errors: Vec<FieldError>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
struct FieldError {
    pointer: String,
    detail: String,
}

impl Refusal {
    fn read(status: StatusCode, body: &[u8]) -> Self {
        Self {
            status: status.as_u16(),
            problem: serde_json::from_slice(body).unwrap_or_default(),
        }
    }
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Problem {
            title,
            detail,
            errors,
        } = &self.problem;
        write!(f, "{}", self.status)?;
        if !title.is_empty() {
            write!(f, " {title}")?;
        }
        if !detail.is_empty() && detail != title {
            write!(f, ": {detail}")?;
        }
        for error in errors {
            write!(f, " [at {}", error.pointer)?;
            if !error.detail.is_empty() && error.detail != *detail {
                write!(f, ": {}", error.detail)?;
            }
            write!(f, "]")?;
        }
        Ok(())
    }
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
/// 408, 429, 5xx, resets and time-outs: the same bytes again after `Retry-After`, else after
/// 1 s × 2ⁿ up to 5 min, with jitter. Any other 4xx: never again.
pub(super) struct Gateway {
    client: reqwest::Client,
    url: String,
    reached: Arc<AtomicBool>,
    notify: Box<dyn Fn(&str) + Send + Sync>,
}

impl Gateway {
    /// A client of the service at `url`; `notify` is told of every wait.
    pub(super) fn new(
        url: &str,
        notify: impl Fn(&str) + Send + Sync + 'static,
    ) -> Result<Self, GatewayError> {
        let url = url.trim_end_matches('/').to_owned();
        let mut builder = reqwest::Client::builder()
            .user_agent(concat!("mapshift/", env!("CARGO_PKG_VERSION")))
            .connect_timeout(CONNECT_TIMEOUT)
            .timeout(REQUEST_TIMEOUT)
            .redirect(reqwest::redirect::Policy::none());
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

    /// The same client with somebody else to tell of waits.
    pub(super) fn notifying(&self, notify: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self {
            client: self.client.clone(),
            url: self.url.clone(),
            reached: self.reached.clone(),
            notify: Box::new(notify),
        }
    }

    /// Where a route's resources are.
    pub(super) fn route_url(&self, route: &RouteId) -> String {
        format!("{}/v1/routes/{route}", self.url)
    }

    /// Makes the route unless it is there; says whether it was made.
    pub(super) async fn ensure_route(
        &self,
        route: &RouteId,
        display_name: Option<&str>,
    ) -> Result<bool, GatewayError> {
        match self.route(route).await {
            Ok(_) => Ok(false),
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
    pub(super) async fn put_batch(
        &self,
        route: &RouteId,
        batch: &EncodedBatch,
    ) -> Result<Outcome, GatewayError> {
        let answer = self
            .send(Request {
                method: Method::PUT,
                path: format!("/v1/routes/{route}/batches/{}", batch.id),
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

    /// How a route stands.
    pub(super) async fn route(&self, route: &RouteId) -> Result<RouteReport, GatewayError> {
        self.get(format!("/v1/routes/{route}"), format!("route {route}"))
            .await
    }

    /// What became of a batch.
    pub(super) async fn batch(
        &self,
        route: &RouteId,
        batch: &BatchId,
    ) -> Result<BatchReport, GatewayError> {
        let path = format!("/v1/routes/{route}/batches/{batch}");
        self.get(path, format!("batch {batch}")).await
    }

    async fn get<T: DeserializeOwned>(
        &self,
        path: String,
        what: String,
    ) -> Result<T, GatewayError> {
        let request = Request {
            method: Method::GET,
            path,
            what: what.clone(),
            body: None,
            gzip: false,
        };
        let answer = self.send(request).await?;
        serde_json::from_slice(&answer.body).map_err(|source| GatewayError::Answer {
            what,
            url: self.url.clone(),
            source,
        })
    }

    async fn send(&self, request: Request<'_>) -> Result<Answer, GatewayError> {
        let mut waited = Duration::ZERO;
        let mut attempt = 0;
        loop {
            let (failure, retry_after) = match self.attempt(&request).await {
                Ok(answer) if answer.status.is_success() => return Ok(answer),
                Ok(answer) => {
                    let problem = Refusal::read(answer.status, &answer.body);
                    if !is_temporary(answer.status) {
                        let what = request.what;
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

    /// A wrong address should be told at once, a service that restarts waited for.
    fn never_reached(&self, error: &reqwest::Error) -> bool {
        error.is_connect() && !self.reached.load(Ordering::Relaxed)
    }
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

fn is_temporary(status: StatusCode) -> bool {
    status.is_server_error()
        || status == StatusCode::REQUEST_TIMEOUT
        || status == StatusCode::TOO_MANY_REQUESTS
}

/// Seconds, as the service states them; the other form, a date, is not used by it.
fn retry_after(headers: &HeaderMap) -> Option<Duration> {
    let seconds = headers
        .get(RETRY_AFTER)?
        .to_str()
        .ok()?
        .trim()
        .parse()
        .ok()?;
    Some(Duration::from_secs(seconds))
}

/// The stated wait and up to a quarter more, or 1 s × 2ⁿ up to 5 min of which at least the half
/// is waited. The jitter follows from the key, so that clients with different keys spread out.
fn wait_before_repeat(attempt: u32, stated: Option<Duration>, key: &str) -> Duration {
    let digest = Sha256::digest(format!("{attempt} {key}"));
    let jitter = f64::from(digest[0]) / 255.0;
    match stated {
        Some(stated) => stated.min(WAIT_MAX).mul_f64(1.0 + 0.25 * jitter),
        None => {
            let doubled = WAIT_FIRST.saturating_mul(2_u32.saturating_pow(attempt));
            doubled.min(WAIT_MAX).mul_f64(0.5 + 0.5 * jitter)
        }
    }
}

fn innermost(error: &reqwest::Error) -> String {
    let mut cause: &dyn std::error::Error = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::{TcpListener, TcpStream};

    /// Reads one request with its body.
    async fn read_request(stream: &mut TcpStream) -> Option<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut chunk = [0; 4096];
        loop {
            let head_end = bytes.windows(4).position(|w| w == b"\r\n\r\n");
            if let Some(head_end) = head_end {
                let head = String::from_utf8_lossy(&bytes[..head_end]).to_lowercase();
                let length = head
                    .lines()
                    .find_map(|l| l.strip_prefix("content-length: ")?.parse().ok())
                    .unwrap_or(0);
                if bytes.len() >= head_end + 4 + length {
                    return Some(bytes);
                }
            }
            match stream.read(&mut chunk).await {
                Ok(read) if read > 0 => bytes.extend_from_slice(&chunk[..read]),
                _ => return None,
            }
        }
    }

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
            id: BatchId::new("t-00000").unwrap(),
            gzip: vec![0x1f, 0x8b, 1, 2, 3],
        }
    }

    fn route() -> RouteId {
        RouteId::new("line-4").unwrap()
    }

    const ACCEPTED: &str =
        "HTTP/1.1 202 Accepted\r\ncontent-length: 0\r\nconnection: close\r\n\r\n";
    const REPLAYED: &str = "HTTP/1.1 200 OK\r\ncontent-length: 2\r\nconnection: close\r\n\r\n{}";
    const BUSY: &str = "HTTP/1.1 503 Service Unavailable\r\nretry-after: 0\r\n\
        content-length: 0\r\nconnection: close\r\n\r\n";
    const TOO_MANY: &str = "HTTP/1.1 429 Too Many Requests\r\nretry-after: 0\r\n\
        content-length: 0\r\nconnection: close\r\n\r\n";
    const REFUSED: &str = "HTTP/1.1 422 Unprocessable Entity\r\nconnection: close\r\n\
        content-length: 127\r\n\r\n\
        {\"title\":\"The scans fit no lidar\",\"detail\":\"did you send degrees?\",\
        \"errors\":[{\"pointer\":\"/lidar/angle_min\",\"detail\":\"-180.0\"}]}";

    #[tokio::test]
    async fn temporary_failures_are_repeated_with_the_same_bytes() {
        let (url, requests) = scripted(&[BUSY, TOO_MANY, ACCEPTED]).await;
        let told = Arc::new(Mutex::new(Vec::new()));
        let tell = told.clone();
        let gateway = Gateway::new(&url, move |t| tell.lock().unwrap().push(t.to_owned())).unwrap();
        let outcome = gateway.put_batch(&route(), &batch()).await.unwrap();
        assert_eq!(outcome, Outcome::Stored);
        assert_eq!(told.lock().unwrap().len(), 2);
        let requests = requests.lock().unwrap();
        assert_eq!(requests.len(), 3);
        assert_eq!(requests[0], requests[2]);
        assert!(requests[0].starts_with(b"PUT /v1/routes/line-4/batches/t-00000 HTTP/1.1\r\n"));
        let text = String::from_utf8_lossy(&requests[0]).to_lowercase();
        assert!(text.contains("content-encoding: gzip") && text.contains("application/json"));
        assert!(requests[0].ends_with(&[0x1f, 0x8b, 1, 2, 3]));
    }

    #[tokio::test]
    async fn a_cut_connection_is_repeated_and_a_replay_is_told() {
        let (url, requests) = scripted(&["", REPLAYED]).await;
        let gateway = Gateway::new(&url, |_| ()).unwrap();
        let outcome = gateway.put_batch(&route(), &batch()).await.unwrap();
        assert_eq!(outcome, Outcome::Replayed);
        assert_eq!(requests.lock().unwrap().len(), 2);
    }

    #[tokio::test]
    async fn a_refusal_is_final_and_in_the_services_words() {
        let (url, requests) = scripted(&[REFUSED, ACCEPTED]).await;
        let gateway = Gateway::new(&url, |_| ()).unwrap();
        let error = gateway.put_batch(&route(), &batch()).await.unwrap_err();
        assert_eq!(
            error.to_string(),
            "batch t-00000 was refused: 422 The scans fit no lidar: did you send degrees? \
             [at /lidar/angle_min: -180.0]"
        );
        assert_eq!(requests.lock().unwrap().len(), 1);
    }

    #[tokio::test]
    async fn a_wrong_address_is_told_at_once() {
        let free = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", free.local_addr().unwrap());
        drop(free);
        let gateway = Gateway::new(&url, |_| ()).unwrap();
        let error = gateway.route(&route()).await.unwrap_err();
        assert!(
            matches!(error, GatewayError::Unreachable { .. }),
            "{error:?}"
        );
        let gateway = Gateway::new("nonsense", |_| ()).unwrap();
        let error = gateway.route(&route()).await.unwrap_err();
        assert!(matches!(error, GatewayError::Url { .. }), "{error:?}");
    }

    #[test]
    fn waits_double_and_obey_what_is_stated() {
        for attempt in 0..40 {
            let doubled = 2_f64.powi(attempt as i32).min(300.0);
            let wait = wait_before_repeat(attempt, None, "a").as_secs_f64();
            assert!(
                (0.5 * doubled..=doubled).contains(&wait),
                "{attempt}: {wait}"
            );
            let stated = Some(Duration::from_secs(8));
            let wait = wait_before_repeat(attempt, stated, "a").as_secs_f64();
            assert!((8.0..=10.0).contains(&wait), "{wait}");
        }
        let spread = |key| wait_before_repeat(3, None, key);
        assert_eq!(spread("a"), spread("a"));
        assert_ne!(spread("a"), spread("b"));
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
}
