//! Work that neither the log nor the metrics tell of.

use std::future::Future;

use anyhow::Context;
use metrics::{NoopRecorder, with_local_recorder};
use tokio::sync::oneshot;
use tracing::subscriber::{NoSubscriber, with_default};

/// Runs work on a thread and a runtime of its own, without its log lines and metrics.
///
/// # Errors
/// Those of the work, and if the thread or the runtime cannot be started.
pub(in crate::pipeline) async fn silently<T: Send + 'static, F>(
    work: impl FnOnce() -> F + Send + 'static,
) -> anyhow::Result<T>
where
    F: Future<Output = anyhow::Result<T>>,
{
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start a runtime")?;
    let (sender, receiver) = oneshot::channel();
    let thread = std::thread::Builder::new().name("rebuild".to_owned());
    let run = move || {
        let outcome = hushed(|| runtime.block_on(work()));
        // Whoever waited is gone at shutdown.
        let _ = sender.send(outcome);
    };
    thread.spawn(run).context("cannot start a thread")?;
    receiver
        .await
        .context("the work ended without an outcome")?
}

/// Runs work on this thread without its log lines and metrics.
pub(in crate::pipeline) fn hushed<T>(work: impl FnOnce() -> T) -> T {
    with_local_recorder(&NoopRecorder, || {
        with_default(NoSubscriber::default(), work)
    })
}
