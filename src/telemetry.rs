//! Logs and metrics of the process.
//!
//! Knows of what is logged and counted no more than its names. Begin with [`init_log`].

use std::io::IsTerminal;
use std::sync::OnceLock;

use anyhow::Context;
use metrics::Unit;
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use tracing_subscriber::EnvFilter;

use crate::config::LogFormat;
use crate::model::BatchStatus;

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

/// A metric of the service, as `/metrics` describes it.
#[derive(Debug, Clone, Copy)]
pub struct Metric {
    /// Its name, with its unit.
    pub name: &'static str,
    kind: MetricKind,
    unit: Option<Unit>,
    help: &'static str,
}

#[derive(Debug, Clone, Copy)]
enum MetricKind {
    Counter,
    Gauge,
    Histogram,
}

const fn counter(name: &'static str, help: &'static str) -> Metric {
    metric(name, MetricKind::Counter, None, help)
}

const fn gauge(name: &'static str, help: &'static str) -> Metric {
    metric(name, MetricKind::Gauge, None, help)
}

const fn metric(
    name: &'static str,
    kind: MetricKind,
    unit: Option<Unit>,
    help: &'static str,
) -> Metric {
    Metric {
        name,
        kind,
        unit,
        help,
    }
}

impl Metric {
    const fn in_bytes(self) -> Self {
        self.in_unit(Unit::Bytes)
    }

    const fn in_unit(self, unit: Unit) -> Self {
        Self {
            unit: Some(unit),
            ..self
        }
    }

    fn describe(&self) {
        let Self { name, help, .. } = *self;
        match (self.kind, self.unit) {
            (MetricKind::Counter, None) => metrics::describe_counter!(name, help),
            (MetricKind::Counter, Some(unit)) => metrics::describe_counter!(name, unit, help),
            (MetricKind::Gauge, None) => metrics::describe_gauge!(name, help),
            (MetricKind::Gauge, Some(unit)) => metrics::describe_gauge!(name, unit, help),
            (MetricKind::Histogram, None) => metrics::describe_histogram!(name, help),
            (MetricKind::Histogram, Some(unit)) => metrics::describe_histogram!(name, unit, help),
        }
    }
}

/// Every metric of the service. docs/reference/metrics.md says more of each.
pub const METRICS: &[Metric] = &[
    gauge("mapshift_build_info", "1, with the version of the program and of its schema as labels"),
    counter("mapshift_http_requests_total", "Requests answered"),
    metric(
        "mapshift_http_request_duration_seconds",
        MetricKind::Histogram,
        Some(Unit::Seconds),
        "Time to answer a request",
    ),
    counter("mapshift_uploads_total", "Uploads by outcome"),
    gauge("mapshift_pending_batches", "Batches that wait to be processed"),
    gauge("mapshift_batches", "Batches that are not in a map, by status"),
    counter(
        "mapshift_batches_ended_total",
        "Batches by final status; a batch that is tried again is counted again",
    ),
    gauge(
        "mapshift_queue_oldest_seconds",
        "Age of the oldest batch that waits for its first attempt; 0 if none does",
    )
    .in_unit(Unit::Seconds),
    gauge("mapshift_open_alerts", "Alerts that wait for a decision and are not muted"),
    gauge("mapshift_vehicles", "Vehicles that are suspect, and that are quarantined, counted by route"),
    gauge("mapshift_routes", "Routes by stage"),
    counter(
        "mapshift_map_mendings_total",
        "Misplaced segments of maps that were moved by closures",
    ),
    gauge("mapshift_maps_in_memory", "Maps kept in memory between batches"),
    gauge("mapshift_maps_in_memory_bytes", "Approximate size of these maps").in_bytes(),
    gauge("mapshift_database_bytes", "Length of the database, its write-ahead log included").in_bytes(),
    gauge("mapshift_database_unused_bytes", "Unused bytes in the database, which are filled before the file grows")
        .in_bytes(),
    gauge("mapshift_wal_bytes", "Length of the write-ahead log").in_bytes(),
    gauge("mapshift_disk_free_bytes", "Bytes that are free on the disk of the data directory").in_bytes(),
    gauge(
        "mapshift_disk_growth_bytes_per_day",
        "Growth of what the database holds, over the last week or since the start; NaN on the first day",
    )
    .in_bytes(),
    gauge(
        "mapshift_disk_full_in_days",
        "Days until the disk is full at that growth; +Inf without growth, NaN on the first day",
    ),
    counter("mapshift_bodies_deleted_total", "Bodies of uploads deleted after their retention"),
    counter("mapshift_bodies_deleted_bytes_total", "Length of those bodies, compressed").in_bytes(),
    counter("mapshift_trajectory_scans_deleted_total", "Scans between keyframes deleted when their time was over"),
    counter("mapshift_names_redacted_total", "Rows in which names of people were redacted when their time was over"),
    counter("mapshift_corrupt_scans_total", "Scans that were left out of a map because they are corrupt on the disk"),
    counter("mapshift_webhook_attempts_total", "Attempts to call webhooks by what followed: delivered, retried, failed, gone"),
    metric(
        "mapshift_webhook_attempt_duration_seconds",
        MetricKind::Histogram,
        Some(Unit::Seconds),
        "Time to call a webhook",
    ),
    gauge("mapshift_connections", "Open connections"),
    counter(
        "mapshift_limit_refusals_total",
        "Connections and requests refused, by limit and scope: the address has used its share, or the service is full",
    ),
    counter(
        "mapshift_connections_displaced_total",
        "Connections without a request that were closed to make room for others",
    ),
    counter("mapshift_slow_bodies_total", "Requests whose body came too slowly"),
    counter(
        "mapshift_stalled_clients_total",
        "Connections closed because their client did not read the response",
    ),
];

fn install() -> anyhow::Result<PrometheusHandle> {
    let handle = PrometheusBuilder::new()
        .set_buckets_for_metric(Matcher::Suffix("_seconds".into()), &DURATION_BUCKETS_S)?
        .install_recorder()?;
    METRICS.iter().for_each(Metric::describe);
    begin_at_zero();
    Ok(handle)
}

/// Counters that a rule watches for their first increment are there from the start: Prometheus sees no
/// increase in a series that begins with 1, and a sum with a series that is missing is missing.
fn begin_at_zero() {
    let without_labels = [
        "mapshift_bodies_deleted_bytes_total",
        "mapshift_bodies_deleted_total",
        "mapshift_trajectory_scans_deleted_total",
        "mapshift_names_redacted_total",
        "mapshift_corrupt_scans_total",
        "mapshift_map_mendings_total",
        "mapshift_connections_displaced_total",
        "mapshift_slow_bodies_total",
        "mapshift_stalled_clients_total",
    ];
    for name in without_labels {
        metrics::counter!(name).absolute(0);
    }
    for outcome in ["stored", "replayed", "disk-full"] {
        metrics::counter!("mapshift_uploads_total", "outcome" => outcome).absolute(0);
    }
    for outcome in ["delivered", "retried", "failed", "gone"] {
        metrics::counter!("mapshift_webhook_attempts_total", "outcome" => outcome).absolute(0);
    }
    use BatchStatus::{Merged, Quarantined, Removed, Unanchored};
    for status in [Merged, Unanchored, Quarantined, Removed] {
        let status = status.name();
        metrics::counter!("mapshift_batches_ended_total", "status" => status).absolute(0);
    }
}
