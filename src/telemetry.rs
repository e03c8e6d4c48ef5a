//! Logs and metrics of the process.
//!
//! Knows nothing of what is logged or counted. Begin with [`init_log`].

use std::io::IsTerminal;
use std::sync::OnceLock;

use anyhow::Context;
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use tracing_subscriber::EnvFilter;

use crate::config::LogFormat;

/// Upper bounds of the classes of durations, seconds.
const DURATION_BUCKETS_S: [f64; 11] = [
    0.001, 0.002_5, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0, 5.0, 30.0,
];

/// Sends the log to standard error. Call it once, first thing.
///
/// # Errors
/// If the filter is not understood, or a log is set up already.
pub fn init_log(filter: &str, format: LogFormat) -> anyhow::Result<()> {
    let filter = EnvFilter::try_new(filter).context("the log filter is not understood")?;
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    let outcome = match format {
        LogFormat::Text => log.try_init(),
        LogFormat::Json => log.json().flatten_event(true).try_init(),
    };
    outcome.map_err(|error| anyhow::anyhow!("the log cannot be set up: {error}"))
}

/// What the process's metrics are read from; the same for every service in the process.
///
/// # Errors
/// If another recorder is installed.
pub fn metrics_handle() -> anyhow::Result<PrometheusHandle> {
    static HANDLE: OnceLock<Result<PrometheusHandle, String>> = OnceLock::new();
    let handle = HANDLE.get_or_init(|| install().map_err(|error| format!("{error:#}")));
    handle.clone().map_err(anyhow::Error::msg)
}

fn install() -> anyhow::Result<PrometheusHandle> {
    let handle = PrometheusBuilder::new()
        .set_buckets_for_metric(Matcher::Suffix("_seconds".into()), &DURATION_BUCKETS_S)?
        .install_recorder()?;
    metrics::describe_counter!("mapshift_http_requests_total", "Requests answered");
    metrics::describe_histogram!(
        "mapshift_http_request_duration_seconds",
        metrics::Unit::Seconds,
        "Time to answer a request"
    );
    metrics::describe_counter!("mapshift_uploads_total", "Uploads by how they ended");
    metrics::describe_gauge!(
        "mapshift_pending_batches",
        "Batches that wait to be processed"
    );
    metrics::describe_counter!(
        "mapshift_map_mendings_total",
        "Segments of maps that lay in the wrong place and were put right by closures"
    );
    metrics::describe_gauge!("mapshift_connections", "Open connections");
    metrics::describe_counter!(
        "mapshift_webhook_attempts_total",
        "Attempts to call webhooks by what followed: delivered, retried, failed, gone"
    );
    metrics::describe_histogram!(
        "mapshift_webhook_attempt_duration_seconds",
        metrics::Unit::Seconds,
        "Time to call a webhook"
    );
    describe_limits();
    describe_what_is_kept();
    Ok(handle)
}

fn describe_limits() {
    metrics::describe_counter!(
        "mapshift_limit_refusals_total",
        "Connections and requests refused, by limit, and by scope: the address has its share, or the service has no more"
    );
    metrics::describe_counter!(
        "mapshift_connections_displaced_total",
        "Connections without a request that were closed to make room for others"
    );
    metrics::describe_counter!(
        "mapshift_slow_bodies_total",
        "Requests whose body came too slowly"
    );
    metrics::describe_counter!(
        "mapshift_stalled_clients_total",
        "Connections cut off because their client did not take its answer"
    );
}

fn describe_what_is_kept() {
    let bytes = metrics::Unit::Bytes;
    metrics::describe_gauge!(
        "mapshift_maps_in_memory",
        "Maps kept in memory between batches"
    );
    metrics::describe_gauge!(
        "mapshift_maps_in_memory_bytes",
        bytes,
        "What they take, about"
    );
    metrics::describe_gauge!("mapshift_database_bytes", bytes, "Length of the database");
    metrics::describe_counter!(
        "mapshift_bodies_deleted_total",
        "Bodies of uploads deleted when their time was over"
    );
    metrics::describe_counter!(
        "mapshift_bodies_deleted_bytes_total",
        bytes,
        "Length of those bodies, compressed"
    );
}
