//! The task that sends due deliveries: one at a time to each webhook, all webhooks in parallel, so that a slow
//! receiver delays only itself.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use tokio::task::{Id, JoinError, JoinSet};
use tokio_util::sync::CancellationToken;

use super::message::{Forms, MessageError, message};
use super::schedule::verdict;
use super::sender::Sender;
use crate::ids::WebhookId;
use crate::store::{Attempt, AttemptEnd, AttemptVerdict, NextDelivery, Store, StoreError};

/// How often the store is polled for due deliveries.
const LOOK: Duration = Duration::from_millis(500);
/// Pause before a delivery is tried again whose attempt could not be recorded.
const REST: Duration = Duration::from_secs(5);
/// Time for running attempts when the service stops; interrupted ones are repeated.
const GRACE: Duration = Duration::from_secs(2);

/// Sends due deliveries; cheap to clone.
#[derive(Clone)]
pub(super) struct Dispatcher {
    pub store: Store,
    pub sender: Sender,
    pub forms: Arc<dyn Forms>,
    /// Pauses after attempts that failed.
    pub pauses: Vec<Duration>,
}

/// Running attempts by webhook.
#[derive(Default)]
struct UnderWay {
    tasks: JoinSet<()>,
    webhooks: HashMap<Id, WebhookId>,
}

/// Why the end of an attempt could not be recorded.
#[derive(Debug, thiserror::Error)]
enum AttemptError {
    #[error("there is no message")]
    Message(#[from] MessageError),
    #[error("the attempt could not be noted")]
    Store(#[from] StoreError),
}

impl Dispatcher {
    /// Sends until `stopping` is cancelled.
    pub async fn run(self, stopping: CancellationToken) {
        let mut under_way = UnderWay::default();
        loop {
            match self.store.next_deliveries().await {
                Ok(next) => self.start_due(next, &mut under_way),
                Err(error) => tracing::warn!(%error, "deliveries could not be looked through"),
            }
            tokio::select! {
                () = stopping.cancelled() => break,
                () = under_way.ended() => {}
                () = tokio::time::sleep(LOOK) => {}
            }
        }
        if tokio::time::timeout(GRACE, under_way.all_ended())
            .await
            .is_err()
        {
            tracing::info!("deliveries under way were cut off; they are sent again");
        }
    }

    fn start_due(&self, next: Vec<NextDelivery>, under_way: &mut UnderWay) {
        let now = Timestamp::now();
        for next in next {
            if next.due_at <= now && !under_way.has(next.webhook_id) {
                let webhook = next.webhook_id;
                under_way.start(webhook, self.clone().see_through(next));
            }
        }
    }

    async fn see_through(self, next: NextDelivery) {
        if let Err(error) = self.attempt(&next).await {
            let (webhook, delivery) = (next.webhook_id, &next.id);
            tracing::warn!(%webhook, delivery, cause = ?error, "{error}");
            tokio::time::sleep(REST).await;
        }
    }

    /// Reads, sends, and records the outcome.
    async fn attempt(&self, next: &NextDelivery) -> Result<(), AttemptError> {
        let Some(message) = message(&self.store, &*self.forms, next).await? else {
            return Ok(());
        };
        let started = std::time::Instant::now();
        let sent = self.sender.send(next, message.body).await;
        metrics::histogram!("mapshift_webhook_attempt_duration_seconds").record(started.elapsed());
        let ended_at = Timestamp::now();
        let verdict = verdict(next, sent.end, sent.asked, &self.pauses, ended_at);
        let attempt = Attempt {
            delivery_key: next.key,
            attempts: next.attempts + 1,
            webhook_revision: next.webhook_revision,
            alert_revision: message.alert_revision,
            ended_at,
            end: sent.end,
            verdict,
        };
        self.store.record_attempt(attempt).await?;
        tell(next, sent.end, verdict);
        Ok(())
    }
}

/// The URL stays out of the log: it may hold a token.
fn tell(next: &NextDelivery, end: AttemptEnd, verdict: AttemptVerdict) {
    let outcome = match verdict {
        AttemptVerdict::Delivered => "delivered",
        AttemptVerdict::RetryAt(_) => "retried",
        AttemptVerdict::Failed => "failed",
        AttemptVerdict::Gone => "gone",
    };
    metrics::counter!("mapshift_webhook_attempts_total", "outcome" => outcome).increment(1);
    let (webhook, delivery, attempts) = (next.webhook_id, &next.id, next.attempts + 1);
    match verdict {
        AttemptVerdict::Delivered | AttemptVerdict::RetryAt(_) => {
            tracing::debug!(%webhook, delivery, attempts, ?end, outcome, "a webhook was called");
        }
        AttemptVerdict::Failed | AttemptVerdict::Gone => {
            tracing::warn!(%webhook, delivery, attempts, ?end, outcome, "a webhook could not be delivered");
        }
    }
}

impl UnderWay {
    fn has(&self, webhook: WebhookId) -> bool {
        self.webhooks.values().any(|other| *other == webhook)
    }

    fn start(&mut self, webhook: WebhookId, work: impl Future<Output = ()> + Send + 'static) {
        let task = self.tasks.spawn(work);
        self.webhooks.insert(task.id(), webhook);
    }

    /// Waits for the next attempt to end, for ever if none is running. Cancel-safe.
    async fn ended(&mut self) {
        match self.tasks.join_next_with_id().await {
            Some(Ok((id, ()))) => self.forget(id),
            Some(Err(error)) => self.note_panic(&error),
            None => std::future::pending().await,
        }
    }

    async fn all_ended(&mut self) {
        while !self.tasks.is_empty() {
            self.ended().await;
        }
    }

    fn forget(&mut self, id: Id) {
        self.webhooks.remove(&id);
    }

    fn note_panic(&mut self, error: &JoinError) {
        tracing::error!(%error, "an attempt to call a webhook panicked");
        self.forget(error.id());
    }
}
