//! `mapshift serve`.

use std::io::Write;

use anyhow::Context;
use tokio::signal::unix::{Signal, SignalKind, signal};

use crate::app;
use crate::config::ServiceArgs;
use crate::telemetry;

/// Arguments of `mapshift serve`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    service: ServiceArgs,
}

/// Runs the service until SIGTERM or ctrl-c.
///
/// # Errors
/// If the settings are refused, or the service cannot start or stop in order.
pub fn run(args: Args) -> anyhow::Result<()> {
    let config = args.service.app_config();
    telemetry::init_log(&args.service.log, args.service.log_format)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let outcome = runtime.block_on(async {
        let data_dir = config.data_dir.display().to_string();
        let mut stop = StopSignal::listen()?;
        let app = app::start(config).await?;
        let address = app.local_addr();
        // The log's reader may be gone; the service keeps running.
        let _ = writeln!(
            std::io::stdout(),
            "mapshift listens on http://{address}, data in {data_dir}"
        );
        stop.received().await;
        tracing::info!("stopping; a second signal stops at once");
        tokio::select! {
            outcome = app.shutdown() => outcome,
            () = stop.received() => anyhow::bail!("stopped at once by a second signal"),
        }
    });
    // Work on blocking threads cannot be cancelled and must not delay the end.
    runtime.shutdown_background();
    outcome
}

/// SIGTERM and ctrl-c.
pub(super) struct StopSignal {
    terminate: Signal,
    interrupt: Signal,
}

impl StopSignal {
    pub(super) fn listen() -> anyhow::Result<Self> {
        Ok(Self {
            terminate: signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?,
            interrupt: signal(SignalKind::interrupt()).context("cannot listen for ctrl-c")?,
        })
    }

    /// Waits for the next signal.
    pub(super) async fn received(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}
