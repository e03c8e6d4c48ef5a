//! One attempt: one POST. Of the response only the status and `Retry-After` are read.

use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use reqwest::header::{CONTENT_TYPE, RETRY_AFTER};

use super::address::ReceiverPolicy;
use super::resolver::{GuardedResolver, NameRefusal};
use super::schedule::asked_wait;
use super::signature::signatures;
use crate::http_client;
use crate::model::DeliveryFailure;
use crate::store::{AttemptEnd, NextDelivery};

/// How an attempt ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sent {
    pub end: AttemptEnd,
    /// The wait that the answer asked for.
    pub asked: Option<Duration>,
}

impl From<DeliveryFailure> for Sent {
    fn from(failure: DeliveryFailure) -> Self {
        Self {
            end: AttemptEnd::Failure(failure),
            asked: None,
        }
    }
}

/// Sends to addresses that the policy allows.
#[derive(Clone)]
pub(super) struct Sender {
    client: reqwest::Client,
    policy: ReceiverPolicy,
}

impl Sender {
    /// A sender with a timeout for the whole call, DNS included.
    /// Without system certificates it reaches receivers by http only.
    ///
    /// # Errors
    /// If no client can be built.
    pub fn new(policy: ReceiverPolicy, timeout: Duration) -> Result<Self, reqwest::Error> {
        let client = client(policy, timeout).build().or_else(|error| {
            tracing::warn!(
                cause = ?error,
                "no certificates of authorities are to be had: webhooks cannot be sent by https"
            );
            client(policy, timeout).tls_certs_only([]).build()
        })?;
        Ok(Self { client, policy })
    }

    /// Sends a body, signed again: a signature is valid for minutes only.
    pub async fn send(&self, next: &NextDelivery, body: String) -> Sent {
        // Addresses in URLs are never looked up, and the policy may have changed since.
        let Ok(url) = self.policy.parse(&next.url) else {
            return DeliveryFailure::UrlRefused.into();
        };
        let now = Timestamp::now();
        let timestamp_s = now.as_second();
        let signatures = signatures(next, now, &body);
        let request = self
            .client
            .post(url)
            .header(CONTENT_TYPE, "application/json")
            .header("webhook-id", &next.id)
            .header("webhook-timestamp", timestamp_s)
            .header("webhook-signature", signatures)
            .body(body);
        match request.send().await {
            Ok(answer) => {
                let asked = answer.headers().get(RETRY_AFTER);
                let asked = asked.and_then(|value| value.to_str().ok());
                Sent {
                    end: AttemptEnd::Answer(answer.status().as_u16()),
                    asked: asked.and_then(|text| asked_wait(text, Timestamp::now())),
                }
            }
            Err(error) => failure_of(&error).into(),
        }
    }
}

fn client(policy: ReceiverPolicy, timeout: Duration) -> reqwest::ClientBuilder {
    // A proxy from the environment would bypass the checks, as would redirects, which this client does not
    // follow.
    http_client::builder()
        .dns_resolver(Arc::new(GuardedResolver(policy)))
        .no_proxy()
        .https_only(policy == ReceiverPolicy::Public)
        .timeout(timeout)
        .pool_max_idle_per_host(1)
}

fn failure_of(error: &reqwest::Error) -> DeliveryFailure {
    if error.is_timeout() {
        return DeliveryFailure::Timeout;
    }
    match name_refusal(error) {
        Some(NameRefusal::Unknown(_)) => DeliveryFailure::NameUnknown,
        Some(NameRefusal::Addresses) => DeliveryFailure::AddressRefused,
        None if error.is_connect() => DeliveryFailure::Connection,
        None => DeliveryFailure::BrokenAnswer,
    }
}

/// What the resolver said, somewhere down the causes.
fn name_refusal(error: &reqwest::Error) -> Option<&NameRefusal> {
    let mut cause = error.source();
    while let Some(error) = cause {
        if let Some(refusal) = error.downcast_ref() {
            return Some(refusal);
        }
        cause = error.source();
    }
    None
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    use super::*;
    use crate::ids::WebhookId;
    use crate::model::WebhookEvent;
    use crate::store::WebhookSecret;

    fn next(url: &str) -> NextDelivery {
        NextDelivery {
            key: 1,
            id: "msg_1".into(),
            webhook_id: WebhookId(uuid::Uuid::nil()),
            webhook_revision: 1,
            url: url.into(),
            secret: WebhookSecret([0; 32]),
            previous_secret: None,
            event: WebhookEvent::Test,
            subject: None,
            at: Timestamp::UNIX_EPOCH,
            attempts: 0,
            due_at: Timestamp::UNIX_EPOCH,
        }
    }

    async fn sent(policy: ReceiverPolicy, timeout: Duration, url: &str) -> AttemptEnd {
        let sender = Sender::new(policy, timeout).unwrap();
        sender.send(&next(url), "{}".into()).await.end
    }

    const LONG: Duration = Duration::from_secs(20);

    /// What a receiver that answers with these bytes, and closes, makes of an attempt.
    async fn answered(bytes: &'static [u8]) -> Sent {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let receiver = tokio::spawn(async move {
            let (mut connection, _) = listener.accept().await.unwrap();
            let mut head = [0; 4_096];
            let read = connection.read(&mut head).await.unwrap();
            connection.write_all(bytes).await.unwrap();
            String::from_utf8_lossy(&head[..read]).into_owned()
        });
        let sender = Sender::new(ReceiverPolicy::PrivateToo, LONG).unwrap();
        let url = format!("http://{address}/hook");
        let sent = sender.send(&next(&url), "{}".into()).await;
        let head = receiver.await.unwrap().to_ascii_lowercase();
        assert!(head.starts_with("post /hook http/1.1"), "{head}");
        for header in [
            "content-type: application/json",
            "webhook-id: msg_1",
            "user-agent: mapshift/",
        ] {
            assert!(head.contains(header), "{head}");
        }
        sent
    }

    #[tokio::test]
    async fn an_answer_is_its_status_and_the_wait_that_it_asks_for() {
        let sent =
            answered(b"HTTP/1.1 503 No\r\nretry-after: 7\r\ncontent-length: 0\r\n\r\n").await;
        assert_eq!(sent.end, AttemptEnd::Answer(503));
        assert_eq!(sent.asked, Some(Duration::from_secs(7)));
        // A body that never comes is not waited for.
        let sent = answered(b"HTTP/1.1 200 OK\r\ncontent-length: 1000000\r\n\r\n").await;
        assert_eq!(sent.end, AttemptEnd::Answer(200));
        let sent = answered(
            b"HTTP/1.1 302 There\r\nlocation: http://127.0.0.1:1/\r\ncontent-length: 0\r\n\r\n",
        )
        .await;
        assert_eq!(sent.end, AttemptEnd::Answer(302));
        let sent = answered(b"SSH-2.0-OpenSSH_9.9\r\n").await;
        assert_eq!(sent.end, DeliveryFailure::BrokenAnswer.into_end());
    }

    impl DeliveryFailure {
        fn into_end(self) -> AttemptEnd {
            AttemptEnd::Failure(self)
        }
    }

    #[tokio::test]
    async fn what_is_refused_is_never_connected_to() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let public = ReceiverPolicy::Public;
        for host in [
            "127.0.0.1",
            "2130706433",
            "[::1]",
            "localhost",
            "169.254.169.254",
        ] {
            for scheme in ["http", "https"] {
                let end = sent(public, LONG, &format!("{scheme}://{host}:{port}/")).await;
                assert_eq!(
                    end,
                    DeliveryFailure::UrlRefused.into_end(),
                    "{scheme} {host}"
                );
            }
        }
        // A name that passes the check of URLs, and leads to this machine.
        let client = Sender::new(public, LONG).unwrap().client;
        let error = client
            .post(format!("https://localhost:{port}/"))
            .send()
            .await;
        let failure = failure_of(&error.unwrap_err());
        assert_eq!(failure, DeliveryFailure::AddressRefused);
        let nobody = tokio::time::timeout(Duration::from_millis(50), listener.accept()).await;
        assert!(nobody.is_err(), "somebody came");
    }

    #[tokio::test]
    async fn failures_are_distinguished() {
        let private = ReceiverPolicy::PrivateToo;
        let silent = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/", silent.local_addr().unwrap());
        let end = sent(private, Duration::from_millis(100), &url).await;
        assert_eq!(end, DeliveryFailure::Timeout.into_end());
        drop(silent);
        let end = sent(private, LONG, &url).await;
        assert_eq!(end, DeliveryFailure::Connection.into_end());
        let end = sent(private, LONG, "http://no-such-name.invalid/").await;
        assert_eq!(end, DeliveryFailure::NameUnknown.into_end());
    }
}
