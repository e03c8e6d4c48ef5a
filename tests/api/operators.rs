//! What those who run the service watch: metrics, and one line of the log for each event.

use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

use mapshift::telemetry::METRICS;
use serde_json::{Value, json};

use crate::body::batch;
use crate::changed_hall::{self, APPEARED};
use crate::client::Request;
use crate::log::log_to;
use crate::service::Service;

/// The log of this test's thread, on which its service runs.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Log {
    fn begin() -> (Self, tracing::subscriber::DefaultGuard) {
        let log = Self::default();
        let writer = log.clone();
        let subscriber = tracing_subscriber::fmt()
            .json()
            .flatten_event(true)
            .with_writer(move || writer.clone())
            .finish();
        (log, log_to(subscriber))
    }

    /// The lines with a message.
    fn lines(&self, message: &str) -> Vec<Value> {
        let text = String::from_utf8(self.0.lock().unwrap().clone()).unwrap();
        let lines = text.lines().map(|line| serde_json::from_str(line).unwrap());
        lines
            .filter(|line: &Value| line["message"] == message)
            .collect()
    }

    /// The only line with a message.
    fn only(&self, message: &str) -> Value {
        let mut lines = self.lines(message);
        assert_eq!(lines.len(), 1, "{message}: {lines:?}");
        lines.remove(0)
    }
}

/// Whether a line has these fields with these values.
fn assert_has(line: &Value, fields: &Value) {
    for (name, value) in fields.as_object().unwrap() {
        assert_eq!(&line[name], value, "{name} of {line}");
    }
}

#[tokio::test]
async fn the_log_begins_with_the_version_and_the_settings() {
    let (log, _guard) = Log::begin();
    let directory = tempfile::TempDir::new().unwrap();
    let service = Service::start_changed(directory, |config| {
        config.limits.address_share_percent = 100;
        config.access.public_url = Some("https://maps.example.com".parse().unwrap());
    })
    .await;
    let line = log.only("the service has started");
    let expected = json!({
        "level": "INFO", "version": env!("CARGO_PKG_VERSION"), "access": "open",
        "schema": mapshift::store::schema_version(), "listen": service.address.to_string(),
        "settings": "address-share=100 public-url=https://maps.example.com"
    });
    assert_has(&line, &expected);
    assert!(line["data"].as_str().unwrap().ends_with("/data"));
    service.stop().await;
}

#[tokio::test]
async fn alerts_and_decisions_are_logged() {
    let (log, _guard) = Log::begin();
    let service = changed_hall::start().await;
    let raised = log.only("an alert was raised");
    assert_has(
        &raised,
        &json!({"route": "hall", "alert": APPEARED, "kind": "appeared"}),
    );
    assert_eq!(log.lines("an alert was resolved").len(), 1);
    let decide = |action: &str, tag: &str| {
        let path = format!("/v1/alerts/{APPEARED}/{action}");
        let request = Request::new("POST", path).header("if-match", tag);
        service.send(request.json(&json!({"by": "kim"})))
    };
    assert_eq!(decide("acknowledge", "\"7\"").await.status, 412);
    assert_eq!(log.lines("a decision was made").len(), 0, "none was made");
    assert_eq!(decide("acknowledge", "\"1\"").await.status, 200);
    let decision = log.only("a decision was made");
    let expected = json!({
        "by": "kim", "address": "127.0.0.1", "action": "acknowledge", "route": "hall",
        "alert": APPEARED, "kind": "appeared"
    });
    assert_has(&decision, &expected);
    service.stop().await;
}

#[tokio::test]
async fn quarantines_and_operations_are_logged() {
    let (log, _guard) = Log::begin();
    let service = Service::start_with_map().await;
    let ended = || count(&service, "mapshift_batches_ended_total", "quarantined");
    let before = ended().await;
    // The sequence of the batch that is in the map already.
    let path = "/v1/routes/hall/batches/again";
    let put = Request::new("PUT", path).json(&batch(0, 2));
    let answer = service.send(put).await.json();
    assert_eq!(answer["status"], "quarantined", "{answer}");
    let line = log.only("a batch was quarantined");
    let expected = json!({
        "level": "WARN", "route": "hall", "batch": "again", "reason": answer["reason"]
    });
    assert_has(&line, &expected);
    assert!(ended().await > before);

    for _ in 0..2 {
        let path = "/v1/routes/hall/vehicles/agv-07/quarantine";
        assert_eq!(
            service.send(Request::new("POST", path)).await.status,
            200,
            "safe to repeat"
        );
    }
    let line = log.only("a vehicle was quarantined");
    assert_has(
        &line,
        &json!({"by": "local", "route": "hall", "vehicle": "agv-07"}),
    );

    let removal = Request::new("POST", "/v1/routes/hall/removals")
        .json(&json!({"batches": ["again"], "dry_run": true}));
    let operation = service.send(removal).await.json();
    let path = format!("/v1/operations/{}", operation["id"].as_str().unwrap());
    while service.get(&path).await.json()["ended_at"].is_null() {
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    let line = log.only("an operation has ended");
    assert_has(
        &line,
        &json!({"kind": "removal", "route": "hall", "operation": operation["id"]}),
    );
    service.stop().await;
}

/// The value of a series of a service's metrics; other tests of the process count as well.
async fn count(service: &Service, name: &str, label: &str) -> f64 {
    let metrics = service.get("/metrics").await.text();
    let mut lines = metrics.lines();
    let line = lines.find(|line| line.starts_with(name) && line.contains(&format!("\"{label}\"")));
    let line = line.unwrap_or_else(|| panic!("{name} of {label} is not in\n{metrics}"));
    line.rsplit(' ').next().unwrap().parse().unwrap()
}

/// The names of metrics in a text, without what Prometheus appends to those of histograms.
fn names_in(text: &str) -> BTreeSet<String> {
    let is_of_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let words = text.split(|c| !is_of_name(c));
    let names = words.filter(|word| word.starts_with("mapshift_") && !word.ends_with('_'));
    let base = |name: &str| {
        let suffixes = ["_bucket", "_sum", "_count"];
        let cut = suffixes.iter().find_map(|suffix| name.strip_suffix(suffix));
        cut.unwrap_or(name).to_owned()
    };
    names.map(base).collect()
}

fn read(path: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(root.join(path)).unwrap()
}

fn described() -> BTreeSet<String> {
    METRICS
        .iter()
        .map(|metric| metric.name.to_owned())
        .collect()
}

#[tokio::test]
async fn every_metric_of_the_alert_rules_is_served() {
    let service = Service::start().await;
    service.get("/livez").await;
    let served = names_in(&service.get("/metrics").await.text());
    for path in [
        "deploy/prometheus.rules.yml",
        "deploy/grafana/mapshift.json",
    ] {
        let watched = names_in(&read(path));
        assert!(watched.len() > 5, "{path}: {watched:?}");
        let unknown: Vec<_> = watched.difference(&described()).cloned().collect();
        assert_eq!(unknown, [""; 0], "{path} names what is not described");
        // Those with labels that only what happens gives them, and those of a time that was measured.
        let later = [
            "mapshift_limit_refusals_total",
            "mapshift_webhook_attempt_duration_seconds",
            "mapshift_maps_in_memory",
            "mapshift_maps_in_memory_bytes",
        ];
        let missing: Vec<_> = watched.difference(&served).collect();
        assert!(
            missing.iter().all(|name| later.contains(&name.as_str())),
            "{path}: {missing:?} are not served"
        );
    }
    service.stop().await;
}

#[test]
fn every_metric_is_documented_and_described() {
    let documented = names_in(&read("docs/reference/metrics.md"));
    assert_eq!(documented, described(), "docs/reference/metrics.md");
    let mut used = BTreeSet::new();
    let mut open = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
    while let Some(directory) = open.pop() {
        for entry in std::fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|it| it == "rs") {
                used.extend(names_in(&std::fs::read_to_string(path).unwrap()));
            }
        }
    }
    used.remove("mapshift_session"); // the cookie's name
    assert_eq!(used, described(), "what the sources name");
}
