//! Ten times the gateways that keep the service busy, none of which ever waits.

use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use axum::response::IntoResponse;
use mapshift::api::Limits;
use serde_json::Value;
use tempfile::TempDir;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::client::Client;
use crate::drives::{Batch, two_vehicles};
use crate::gateway::{Answer, Gateway};
use crate::latency::Latencies;
use crate::proc;
use crate::process::Process;
use crate::row::{Finding, Form, Row, run};
use crate::stub;

pub const ROW: Row = Row {
    name: "overload",
    shows: "ten times the load: most of the capacity stays, refusals say when to come back, memory is bounded",
    obstacle: proc::obstacle,
    run: |form| run(overload(form)),
};

const TIMES: usize = 10;
/// Addresses that the gateways come from: no share of one is in the way.
const ADDRESSES: usize = 10;
const GOODPUT_MIN: f64 = 0.6;
const ACCEPTED_WITHIN: Duration = Duration::from_millis(500);
const GROWTH_MAX_BYTES: u64 = 256 << 20;
const BACK_WITHIN: Duration = Duration::from_secs(5);
/// Capacity is back when so much of it is seen in a second.
const BACK_SHARE: f64 = 0.8;
const SAMPLE: Duration = Duration::from_millis(50);

/// What gateways were answered in a while.
#[derive(Default)]
struct Load {
    accepted: Latencies,
    refused: usize,
    /// Connections that were closed without an answer.
    broken: usize,
    faults: Vec<String>,
    took: Duration,
}

impl Load {
    fn goodput_per_s(&self) -> f64 {
        self.accepted.count() as f64 / self.took.as_secs_f64()
    }

    fn note(&mut self, answer: reqwest::Result<Answer>, took: Duration) {
        match answer {
            Ok(answer) if answer.is_acknowledgement() => self.accepted.note(took),
            Ok(answer) if [429, 503].contains(&answer.status) && answer.retry_after_s.is_some() => {
                self.refused += 1;
            }
            Ok(answer) => self.faults.push(format!("an upload got {answer:?}")),
            Err(_) => self.broken += 1,
        }
    }

    fn add(&mut self, other: Self) {
        self.accepted.note_all(other.accepted);
        self.refused += other.refused;
        self.broken += other.broken;
        self.faults.extend(other.faults);
    }
}

async fn overload(form: Form) -> Finding {
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    Client::new(&process.url)
        .put_route("line", Value::Null)
        .await;
    let idle_bytes = proc::resident_bytes(process.id());
    let (peak, watch) = watch_memory(process.id());
    let gateways = Limits::default().uploads / 4;
    let crowd = TIMES * gateways;
    let while_s = Duration::from_secs(form.choose(1, 20));

    let capacity = load(&process.url, gateways, while_s).await;
    let overloaded = load(&process.url, crowd, while_s).await;
    let back_after = time_until_back(&process.url, gateways, capacity.goodput_per_s()).await;
    watch.cancel();

    let mut finding = Finding::default();
    let share = overloaded.goodput_per_s() / capacity.goodput_per_s();
    let p99 = overloaded.accepted.quantile(0.99);
    finding.figure(format!(
        "{:.0} batches/s with {gateways} gateways, {:.0} with {crowd} ({:.0} %); accepted p99 {} ms; {} \
         refused, {} connections broken",
        capacity.goodput_per_s(),
        overloaded.goodput_per_s(),
        100.0 * share,
        p99.as_millis(),
        overloaded.refused,
        overloaded.broken
    ));
    let growth_bytes = peak.load(Ordering::Relaxed).saturating_sub(idle_bytes);
    finding.figure(format!(
        "memory {} MB over idle; capacity back {}",
        growth_bytes >> 20,
        match back_after {
            Some(after) => format!("after {:.1} s", after.as_secs_f64()),
            None => format!("not within {BACK_WITHIN:?}"),
        }
    ));
    finding.faults.extend(capacity.faults);
    finding.faults.extend(overloaded.faults);
    finding.expect(growth_bytes <= GROWTH_MAX_BYTES, || {
        "memory grows without bound".to_owned()
    });
    if form == Form::Full {
        finding.expect(share >= GOODPUT_MIN, || {
            format!("{:.0} % of the goodput is left", 100.0 * share)
        });
        finding.expect(p99 <= ACCEPTED_WITHIN, || {
            format!("accepted uploads take {p99:?} (p99)")
        });
        finding.expect(back_after.is_some(), || {
            "capacity does not come back".to_owned()
        });
    }
    let stub = stub::answering(|| StatusCode::SERVICE_UNAVAILABLE.into_response()).await;
    finding.control = load(&stub, 2, Duration::from_millis(50)).await.faults;
    finding
}

/// The most memory that a process has had, until it is cancelled.
fn watch_memory(process: u32) -> (Arc<AtomicU64>, CancellationToken) {
    let (peak, stop) = (Arc::new(AtomicU64::new(0)), CancellationToken::new());
    let (noted, stopped) = (peak.clone(), stop.clone());
    tokio::spawn(async move {
        while !stopped.is_cancelled() {
            noted.fetch_max(proc::resident_bytes(process), Ordering::Relaxed);
            tokio::time::sleep(SAMPLE).await;
        }
    });
    (peak, stop)
}

/// Gateways that each send one batch after the other, refused or not, for a while.
async fn load(url: &str, gateways: usize, duration: Duration) -> Load {
    // Without the first of their trip they are held: the journal is measured, not the map.
    let body = two_vehicles(24)[0].batches(12).swap_remove(1).body;
    let body: Value = serde_json::from_slice(&body).unwrap();
    let body = Arc::new(body);
    let began = Instant::now();
    let mut sending = JoinSet::new();
    for number in 0..gateways {
        let source = Ipv4Addr::new(127, 0, 5, 1 + (number % ADDRESSES) as u8);
        let gateway = Gateway::from_address(url, source.into());
        let body = body.clone();
        sending.spawn(async move {
            let mut load = Load::default();
            while began.elapsed() < duration {
                let batch = own_batch(&body);
                let sent = Instant::now();
                let answer = gateway.put("line", &batch).await;
                load.note(answer, sent.elapsed());
            }
            load
        });
    }
    let mut all = Load::default();
    while let Some(load) = sending.join_next().await {
        all.add(load.unwrap());
    }
    all.took = began.elapsed();
    all
}

/// A batch that nobody has sent before, of a trip of its own.
fn own_batch(body: &Value) -> Batch {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    let mut body = body.clone();
    body["trip_id"] = format!("t-{number}").into();
    Batch {
        id: format!("b-{number}"),
        body: serde_json::to_vec(&body).unwrap(),
    }
}

/// After how long gateways get through again as before.
async fn time_until_back(url: &str, gateways: usize, capacity_per_s: f64) -> Option<Duration> {
    let began = Instant::now();
    while began.elapsed() < BACK_WITHIN {
        let after = began.elapsed();
        let load = load(url, gateways, Duration::from_secs(1)).await;
        if load.goodput_per_s() >= BACK_SHARE * capacity_per_s {
            return Some(after);
        }
    }
    None
}
