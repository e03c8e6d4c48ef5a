//! The writer's queues: one for uploads, and one for everything else, each with its share of a commit.

use std::time::Duration;

use tokio::sync::mpsc;

use super::error::StoreError;
use super::request::{Reply, Request, Write, pending};

/// Most writes in one commit.
const GROUP_MAX: usize = 64;
/// Places in a full group that are kept for the writes of workers and people while uploads queue up.
const WORK_SHARE: usize = 16;
const UPLOADS_QUEUED_MAX: usize = 256;
const WORK_QUEUED_MAX: usize = 64;
/// How long a write waits for a place in a full queue.
const QUEUE_WAIT: Duration = Duration::from_secs(1);

type Sender = mpsc::Sender<Box<dyn Write>>;
type Receiver = mpsc::Receiver<Box<dyn Write>>;

/// The senders' side.
#[derive(Clone)]
pub(super) struct Outbox {
    uploads: Sender,
    work: Sender,
}

/// The writer's side.
pub(super) struct Inbox {
    uploads: Receiver,
    work: Receiver,
}

/// Both sides of the queues.
pub(super) fn queues() -> (Outbox, Inbox) {
    let (upload_sender, uploads) = mpsc::channel(UPLOADS_QUEUED_MAX);
    let (work_sender, work) = mpsc::channel(WORK_QUEUED_MAX);
    let outbox = Outbox {
        uploads: upload_sender,
        work: work_sender,
    };
    (outbox, Inbox { uploads, work })
}

impl Outbox {
    /// Sends an upload.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] if the queue stays full or is closed; nothing is written then.
    pub(super) async fn send_upload<R: Request>(&self, request: R) -> Result<Reply<R>, StoreError> {
        send(&self.uploads, request).await
    }

    /// Sends anything else.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] if the queue stays full or is closed; nothing is written then.
    pub(super) async fn send_work<R: Request>(&self, request: R) -> Result<Reply<R>, StoreError> {
        send(&self.work, request).await
    }
}

async fn send<R: Request>(sender: &Sender, request: R) -> Result<Reply<R>, StoreError> {
    let (write, reply) = pending(request);
    match sender.send_timeout(write, QUEUE_WAIT).await {
        Ok(()) => Ok(reply),
        Err(_) => Err(StoreError::Unavailable),
    }
}

impl Inbox {
    /// Takes no more; what was taken can still be received.
    pub(super) fn close(&mut self) {
        self.uploads.close();
        self.work.close();
    }

    /// Waits for a write, then takes with it what has queued up: it never waits to fill a group.
    /// `None` when both queues are closed and empty. Loses nothing when it is cancelled.
    pub(super) async fn next_group(&mut self) -> Option<Vec<Box<dyn Write>>> {
        let first = tokio::select! {
            biased;
            Some(write) = self.work.recv() => write,
            Some(write) = self.uploads.recv() => write,
            else => return None,
        };
        let mut group = Vec::with_capacity(GROUP_MAX);
        group.push(first);
        take(&mut self.work, &mut group, WORK_SHARE);
        take(&mut self.uploads, &mut group, GROUP_MAX);
        take(&mut self.work, &mut group, GROUP_MAX);
        Some(group)
    }
}

/// Takes what is there until the group has `length` writes.
fn take(receiver: &mut Receiver, group: &mut Vec<Box<dyn Write>>, length: usize) {
    while group.len() < length
        && let Ok(write) = receiver.try_recv()
    {
        group.push(write);
    }
}
