//! The gate that reads of one weight pass: a few are worked on at once, and one address may have only a
//! share of them under way.

use std::time::Duration;

use tokio::sync::{Semaphore, SemaphorePermit};
use tokio::time::{Instant, timeout_at};

use super::client_address::ClientAddress;
use super::limits::{Limits, Reads};
use super::problem::{Problem, ProblemKind};
use super::shares::{Share, Shares};

/// Bounds the reads of one weight.
pub(super) struct Gate {
    under_way: Shares,
    turns: Semaphore,
}

/// What a read holds while it is worked on.
pub(super) struct Admitted<'a> {
    /// Counts against the client's address until the answer has been sent.
    pub share: Share,
    /// Lets the next read begin once it is dropped.
    pub turn: SemaphorePermit<'a>,
}

impl Gate {
    pub(super) fn new(name: &'static str, reads: Reads, limits: &Limits) -> Self {
        let share = limits.share(reads.under_way);
        Self {
            under_way: Shares::of_requests(name, reads.under_way, share),
            turns: Semaphore::new(reads.at_once),
        }
    }

    /// Waits for a turn, at most `time_max`.
    ///
    /// # Errors
    /// 429 if the address has its share, 503 if no turn comes in time.
    pub(super) async fn enter(
        &self,
        client: ClientAddress,
        time_max: Duration,
    ) -> Result<Admitted<'_>, Problem> {
        let deadline = Instant::now() + time_max;
        let share = self.under_way.take(client, time_max).await?;
        let turn = timeout_at(deadline, self.turns.acquire()).await;
        let turn = turn.map_err(|_| {
            let detail = "too many reads are under way; send the same again later";
            Problem::new(ProblemKind::Overloaded, detail)
        })?;
        let turn = turn.map_err(Problem::internal)?;
        Ok(Admitted { share, turn })
    }
}
