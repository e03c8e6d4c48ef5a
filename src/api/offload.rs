//! Work that keeps a core busy, moved off the threads of request handlers and bounded.

use std::sync::Arc;

use tokio::sync::Semaphore;

use super::problem::Problem;

/// Runs closures on blocking threads, a few at a time.
pub(super) struct Offload {
    permits: Arc<Semaphore>,
}

impl Offload {
    pub(super) fn new(at_once: usize) -> Self {
        Self {
            permits: Arc::new(Semaphore::new(at_once)),
        }
    }

    /// Waits for a turn and runs the closure. If the caller is cancelled, the closure keeps running and keeps its
    /// turn until it ends.
    ///
    /// # Errors
    /// An internal [`Problem`] if the closure panicked.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let permit = self.permits.clone().acquire_owned().await;
        let permit = permit.map_err(Problem::internal)?;
        let task = tokio::task::spawn_blocking(move || {
            let outcome = work();
            drop(permit);
            outcome
        });
        task.await.map_err(Problem::internal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_panic_becomes_a_problem_and_releases_its_turn() {
        let offload = Offload::new(1);
        let outcome: Result<(), _> = offload.run(|| panic!("on purpose")).await;
        assert!(outcome.is_err());
        assert_eq!(offload.run(|| 7).await.unwrap(), 7);
    }
}
