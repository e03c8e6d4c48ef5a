//! The whole service: store, workers and listener, started and stopped together.
//!
//! Knows nothing of what they do in detail. Begin with [`start`].

mod activity;
mod answering;
mod connections;
mod gauges;
mod growth;
mod places;
mod socket;
mod started;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

use crate::api::{self, ApiSettings, ApiState};
use crate::config::AppConfig;
use crate::pipeline;
use crate::store::{Store, StoreOptions};
use crate::telemetry;
use crate::webhooks;

use connections::Connections;
use gauges::Gauges;

const METRICS_UPKEEP: Duration = Duration::from_secs(5);

/// A running service.
pub struct RunningApp {
    local_addr: SocketAddr,
    store: Store,
    draining: CancellationToken,
    stopping: CancellationToken,
    accepting: JoinHandle<()>,
    background: Vec<JoinHandle<()>>,
    drain_timeout: Duration,
}

/// Opens the store, starts the background tasks, listens.
///
/// # Errors
/// If the data directory, the database or the address cannot be used.
pub async fn start(config: AppConfig) -> anyhow::Result<RunningApp> {
    let metrics = telemetry::metrics_handle()?;
    let store = open_store(&config).await?;
    config.check_reach(store.has_keys())?;
    let listener = connections::listen(config.listen)
        .with_context(|| format!("cannot listen on {}", config.listen))?;
    let local_addr = listener.local_addr()?;
    started::report(&config, local_addr, store.has_keys());
    let (draining, stopping) = (CancellationToken::new(), CancellationToken::new());
    let drain_timeout = config.limits.drain_timeout;

    // The one place where background tasks start. Each ends soon after `stopping` is cancelled.
    let pipeline = pipeline::start(&store, config.pipeline, &stopping)?;
    let mut background = pipeline.tasks;
    let receivers = config.delivery.policy;
    let forms = Arc::new(api::EventForms::new(config.access.public_url.clone()));
    let callers = webhooks::start(&store, config.delivery, forms, &stopping)
        .context("cannot call webhooks")?;
    background.extend(callers);
    let upkeep_metrics = metrics.clone();
    let upkeep = move || upkeep_metrics.run_upkeep();
    let upkeep = repeat_until(stopping.clone(), METRICS_UPKEEP, upkeep);
    background.push(tokio::spawn(upkeep));
    let mut gauges = Gauges::new(store.clone());
    gauges.set().await;
    background.push(tokio::spawn(gauges.keep_current(stopping.clone())));

    let settings = ApiSettings {
        limits: config.limits.clone(),
        receivers,
        listen: local_addr.ip(),
        access: config.access,
    };
    let state = ApiState::new(
        store.clone(),
        settings,
        draining.clone(),
        metrics,
        pipeline.decisions,
        pipeline.operations,
    );
    let router = api::router(state).context("the OpenAPI document does not serialise")?;
    let connections = Connections::new(router, config.limits, draining.clone());
    let accepting = tokio::spawn(connections.serve(listener));
    Ok(RunningApp {
        local_addr,
        store,
        draining,
        stopping,
        accepting,
        background,
        drain_timeout,
    })
}

async fn open_store(config: &AppConfig) -> anyhow::Result<Store> {
    let options = StoreOptions {
        data_dir: config.data_dir.clone(),
    };
    let opened = match config.accept_lost_log {
        false => Store::open(options).await,
        true => Store::open_without_log(options).await,
    };
    opened.with_context(|| format!("cannot open the store in {}", config.data_dir.display()))
}

impl RunningApp {
    /// The address that the service listens on.
    pub fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }

    /// Refuses new requests, completes those under way, ends the background tasks and closes the store. Whatever has not
    /// ended within the drain time is cut off.
    ///
    /// # Errors
    /// If the store does not close properly.
    pub async fn shutdown(self) -> anyhow::Result<()> {
        let deadline = Instant::now() + self.drain_timeout;
        self.draining.cancel();
        self.stopping.cancel();
        for mut task in [self.accepting].into_iter().chain(self.background) {
            if timeout_at(deadline, &mut task).await.is_err() {
                tracing::warn!("requests or tasks still under way were cut off");
                task.abort();
            }
        }
        self.store.close().await.context("the store did not close")
    }
}

async fn repeat_until(stopping: CancellationToken, pause: Duration, mut work: impl FnMut()) {
    while tokio::time::timeout(pause, stopping.cancelled())
        .await
        .is_err()
    {
        work();
    }
}
