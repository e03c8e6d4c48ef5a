//! A receiver of webhooks under the test's control.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use serde_json::Value;
use sha2::Sha256;
use tokio::net::TcpListener;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinHandle;

/// What does not come by then is missing, and the test fails.
const PATIENCE: Duration = Duration::from_secs(60);

/// What every answer says beside its status; nobody else may say it.
pub const CANARY: &str = "canary-7f3a";

/// Listens on a port of its own until it is dropped.
pub struct Receiver {
    pub url: String,
    calls: UnboundedReceiver<Call>,
    answers: Arc<Mutex<VecDeque<Answer>>>,
    task: JoinHandle<()>,
}

/// What came.
#[derive(Debug, Clone)]
pub struct Call {
    pub path: String,
    pub headers: HeaderMap,
    pub body: String,
}

/// What is answered.
#[derive(Debug, Clone)]
enum Answer {
    Status(u16, Vec<(&'static str, String)>),
    Never,
}

#[derive(Clone)]
struct Script {
    calls: UnboundedSender<Call>,
    answers: Arc<Mutex<VecDeque<Answer>>>,
}

impl Receiver {
    /// Answers 204 to everything that no other answer was put up for.
    pub async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/hook", listener.local_addr().unwrap());
        let answers = Arc::new(Mutex::new(VecDeque::new()));
        let (sender, calls) = unbounded_channel();
        let script = Script {
            calls: sender,
            answers: Arc::clone(&answers),
        };
        let router = Router::new().fallback(take).with_state(script);
        let serve = async move { axum::serve(listener, router).await.unwrap() };
        Self {
            url,
            calls,
            answers,
            task: tokio::spawn(serve),
        }
    }

    /// The answer to the next call that none is put up for yet.
    pub fn then(&self, status: u16) -> &Self {
        self.then_with(status, Vec::new())
    }

    pub fn then_with(&self, status: u16, headers: Vec<(&'static str, String)>) -> &Self {
        let answer = Answer::Status(status, headers);
        self.answers.lock().unwrap().push_back(answer);
        self
    }

    /// The next call that none is put up for yet is left hanging.
    pub fn then_nothing(&self) {
        self.answers.lock().unwrap().push_back(Answer::Never);
    }

    /// Waits for the next call.
    pub async fn call(&mut self) -> Call {
        let call = tokio::time::timeout(PATIENCE, self.calls.recv()).await;
        call.expect("the webhook is called").unwrap()
    }

    /// Whether a call has come that was not looked at.
    pub fn has_call(&self) -> bool {
        !self.calls.is_empty()
    }
}

impl Drop for Receiver {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn take(
    State(script): State<Script>,
    uri: Uri,
    headers: HeaderMap,
    body: String,
) -> Response {
    let call = Call {
        path: uri.to_string(),
        headers,
        body,
    };
    let _ = script.calls.send(call);
    let answer = script.answers.lock().unwrap().pop_front();
    let (status, headers) = match answer {
        None => (204, Vec::new()),
        Some(Answer::Status(status, headers)) => (status, headers),
        Some(Answer::Never) => std::future::pending().await,
    };
    let status = StatusCode::from_u16(status).unwrap();
    let mut answer = match status {
        StatusCode::NO_CONTENT => status.into_response(),
        _ => (status, format!("{CANARY} in the body")).into_response(),
    };
    let headers = headers.into_iter().chain([("x-canary", CANARY.to_owned())]);
    for (name, value) in headers {
        answer.headers_mut().insert(name, value.parse().unwrap());
    }
    answer
}

impl Call {
    pub fn header(&self, name: &str) -> &str {
        self.headers[name].to_str().unwrap()
    }

    /// The body, if it is signed with the secret; fails otherwise. As a receiver would do it.
    pub fn verified(&self, secret: &str) -> Value {
        let key = STANDARD.decode(secret.strip_prefix("whsec_").unwrap());
        let mut mac = Hmac::<Sha256>::new_from_slice(&key.unwrap()).unwrap();
        let (id, timestamp) = (self.header("webhook-id"), self.header("webhook-timestamp"));
        mac.update(format!("{id}.{timestamp}.{}", self.body).as_bytes());
        let signature = STANDARD.encode(mac.finalize().into_bytes());
        let mut signatures = self.header("webhook-signature").split(' ');
        assert!(signatures.any(|one| one == format!("v1,{signature}")));
        assert_eq!(self.header("content-type"), "application/json");
        let age_s = jiff::Timestamp::now().as_second() - timestamp.parse::<i64>().unwrap();
        assert!((0..300).contains(&age_s), "signed {age_s} s ago");
        serde_json::from_str(&self.body).unwrap()
    }
}
