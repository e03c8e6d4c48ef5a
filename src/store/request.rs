//! Writes on their way to the writer, and back as answers.

use std::future::Future;
use std::path::Path;
use std::pin::Pin;

use sqlx::SqliteConnection;
use tokio::sync::oneshot;

use super::error::StoreError;

/// One write. It is executed inside a transaction that it may share with others, and perhaps
/// more than once: when another write spoils a group, each is executed again on its own.
pub(super) trait Request: Send + Sync + 'static {
    /// What the caller learns after the commit.
    type Outcome: Send + 'static;
    /// Whether a worker may find a job afterwards that it did not find before.
    const QUEUES_JOBS: bool;
    /// Whether it is written on a full disk, in the reserve: what deletes, or notes a state.
    const WHILE_FULL: bool = false;

    /// Another database that it reads, which is there as `other` while it is executed; no other
    /// request shares its transaction.
    fn other_database(&self) -> Option<&Path> {
        None
    }

    /// Writes. An error rolls everything back that this request wrote.
    fn execute(
        &self,
        transaction: &mut SqliteConnection,
    ) -> impl Future<Output = Result<Self::Outcome, StoreError>> + Send;

    /// What the log and the metrics say of it; called once, after the commit.
    fn committed(&self, _: &Self::Outcome) {}
}

/// A request with somebody who waits for its outcome.
struct Pending<R: Request> {
    request: R,
    outcome: Option<R::Outcome>,
    reply: oneshot::Sender<Result<R::Outcome, StoreError>>,
}

/// A [`Request`] of any kind that somebody waits for.
pub(super) trait Write: Send {
    /// Writes and keeps the outcome; replaces the outcome of an earlier execution.
    fn execute<'a>(
        &'a mut self,
        transaction: &'a mut SqliteConnection,
    ) -> Pin<Box<dyn Future<Output = Result<(), StoreError>> + Send + 'a>>;
    /// See [`Request::other_database`].
    fn other_database(&self) -> Option<&Path>;
    /// See [`Request::QUEUES_JOBS`].
    fn queues_jobs(&self) -> bool;
    /// See [`Request::WHILE_FULL`].
    fn runs_while_full(&self) -> bool;
    /// Tells the outcome; only after the commit.
    fn acknowledge(self: Box<Self>);
    /// Tells that nothing is promised.
    fn refuse(self: Box<Self>, error: StoreError);
}

impl<R: Request> Write for Pending<R> {
    fn execute<'a>(
        &'a mut self,
        transaction: &'a mut SqliteConnection,
    ) -> Pin<Box<dyn Future<Output = Result<(), StoreError>> + Send + 'a>> {
        Box::pin(async move {
            self.outcome = None;
            self.outcome = Some(self.request.execute(transaction).await?);
            Ok(())
        })
    }

    fn other_database(&self) -> Option<&Path> {
        self.request.other_database()
    }

    fn queues_jobs(&self) -> bool {
        R::QUEUES_JOBS
    }

    fn runs_while_full(&self) -> bool {
        R::WHILE_FULL
    }

    fn acknowledge(self: Box<Self>) {
        if let Some(outcome) = &self.outcome {
            self.request.committed(outcome);
        }
        let answer = self.outcome.ok_or(StoreError::Unavailable);
        // Whoever asked may have gone; the write stands all the same.
        let _ = self.reply.send(answer);
    }

    fn refuse(self: Box<Self>, error: StoreError) {
        let _ = self.reply.send(Err(error));
    }
}

/// Where the outcome of a request arrives.
pub(super) type Reply<R> = oneshot::Receiver<Result<<R as Request>::Outcome, StoreError>>;

/// A request ready to be sent to the writer, and where its outcome will arrive.
pub(super) fn pending<R: Request>(request: R) -> (Box<dyn Write>, Reply<R>) {
    let (reply, outcome) = oneshot::channel();
    let write = Pending {
        request,
        outcome: None,
        reply,
    };
    (Box::new(write), outcome)
}
