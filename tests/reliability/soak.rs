//! Hours of the same: routes are made, driven, read and deleted, and one request in a hundred is
//! spoiled on the way. Nothing of it piles up.

use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::{Batch, interleaved, two_vehicles};
use crate::fsck;
use crate::gateway::{Gateway, address_of};
use crate::proc;
use crate::process::Process;
use crate::proxy::Proxy;
use crate::row::{Finding, Form, Row, run};

pub const ROW: Row = Row {
    name: "soak",
    shows: "two hours with 1 % faults: memory, descriptors and log stay as they are, and nothing is a 500",
    obstacle: proc::obstacle,
    run: |form| run(soak(form)),
};

const FULL: Duration = Duration::from_secs(2 * 60 * 60);
const QUICK: Duration = Duration::from_secs(5);
/// Until then caches fill; no more of the whole than this share of it.
const WARM_UP_SHARE: f64 = 0.25;
const FAULTY_SHARE: f64 = 0.01;
const PAUSE: Duration = Duration::from_millis(5);
const READS: [&str; 5] = ["", "/graph", "/map.png", "/residuals", "/batches"];

const GROWTH_MAX_MB_PER_H: f64 = 1.0;
/// Connections that come and go, and temporary files.
const DESCRIPTORS_MORE_MAX: usize = 16;
const LOG_BYTES_MAX: u64 = 64 << 20;

/// What is seen of the service after a round.
#[derive(Debug, Clone, Copy)]
struct Sample {
    at: Duration,
    resident_bytes: u64,
    descriptors: usize,
    log_bytes: u64,
}

async fn soak(form: Form) -> Finding {
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    let client = Client::new(&process.url);
    let proxy = Proxy::start(address_of(&process.url), FAULTY_SHARE, 3).await;
    let gateway = Gateway::of_one_request_each(&proxy.url);
    let uploads = interleaved(&two_vehicles(36).map(|drive| drive.batches(6)));
    let duration = form.choose(QUICK, full_time());
    let began = Instant::now();
    let (mut samples, mut faults, mut rounds) = (Vec::new(), Vec::new(), 0);
    while began.elapsed() < duration {
        let route = format!("round-{rounds}");
        client.put_route(&route, Value::Null).await;
        faults.extend(round(&client, &gateway, &route, &uploads).await);
        samples.push(Sample::of(began.elapsed(), process.id(), directory.path()));
        rounds += 1;
    }
    let mut finding = Finding {
        faults,
        ..Finding::default()
    };
    finding.faults.extend(judged(form, &samples));
    let maps = maps_in_memory(&client).await;
    finding.expect(maps == 0.0, || {
        format!("{maps} maps of deleted routes are in memory")
    });
    finding.faults.extend(fsck::faults(directory.path()));
    let (first, last) = (samples[samples.len() / 4], samples[samples.len() - 1]);
    finding.figure(format!(
        "{rounds} rounds in {:.0} s, {} requests spoiled; memory {} MB after a quarter, {} MB at the \
         end ({:.1} MB/h); descriptors {} and {}; log {} MB at most",
        duration.as_secs_f64(),
        proxy.faults(),
        first.resident_bytes >> 20,
        last.resident_bytes >> 20,
        growth_mb_per_h(&samples),
        first.descriptors,
        last.descriptors,
        samples.iter().map(|s| s.log_bytes).max().unwrap_or(0) >> 20
    ));
    // The same with a descriptor that each sample leaves open, and a page of memory a second.
    let leaky = samples.iter().enumerate().map(|(k, sample)| Sample {
        resident_bytes: sample.resident_bytes + (4096.0 * sample.at.as_secs_f64()) as u64,
        descriptors: sample.descriptors + 20 * k,
        ..*sample
    });
    finding.control = judged(form, &leaky.collect::<Vec<_>>());
    finding
}

/// How many routes' maps the service says that it holds.
async fn maps_in_memory(client: &Client) -> f64 {
    let metrics = client.text("/metrics").await;
    let value = metrics
        .lines()
        .find_map(|line| line.strip_prefix("mapshift_maps_in_memory "));
    value.map_or(f64::NAN, |value| value.parse().unwrap())
}

/// Two hours, or as many seconds as `MAPSHIFT_SOAK_S` says.
fn full_time() -> Duration {
    let seconds = std::env::var("MAPSHIFT_SOAK_S").ok();
    let seconds = seconds.map(|text| {
        text.parse()
            .expect("MAPSHIFT_SOAK_S is a number of seconds")
    });
    seconds.map_or(FULL, Duration::from_secs)
}

/// A route's life, and the statuses in it that should not be.
async fn round(client: &Client, gateway: &Gateway, route: &str, uploads: &[Batch]) -> Vec<String> {
    let mut faults = Vec::new();
    for batch in uploads {
        loop {
            match gateway.put(route, batch).await {
                Ok(answer) if answer.is_acknowledgement() => break,
                Ok(answer) if answer.status == 500 => faults.push(format!("{} got 500", batch.id)),
                Ok(_) | Err(_) => {}
            }
            tokio::time::sleep(PAUSE).await;
        }
    }
    client.settled(route, true).await;
    for read in READS {
        let path = format!("/v1/routes/{route}{read}");
        // A connection that broke is the line's.
        if let Ok(status) = gateway.get(&path).await
            && status >= 500
        {
            faults.push(format!("{path} got {status}"));
        }
    }
    let path = format!("/v1/routes/{route}");
    while client.status_of(&path).await == 200 {
        // Deleted over the bad line as well: until it is gone.
        if gateway
            .delete(&path)
            .await
            .is_ok_and(|status| status >= 500)
        {
            faults.push(format!("DELETE {path} was refused"));
        }
    }
    faults
}

impl Sample {
    fn of(at: Duration, process: u32, data: &Path) -> Self {
        let log = std::fs::metadata(data.join("mapshift.db-wal"));
        Self {
            at,
            resident_bytes: proc::resident_bytes(process),
            descriptors: proc::descriptors(process),
            log_bytes: log.map_or(0, |log| log.len()),
        }
    }
}

fn judged(form: Form, samples: &[Sample]) -> Vec<String> {
    let mut finding = Finding::default();
    let warm = &samples[(WARM_UP_SHARE * samples.len() as f64) as usize..];
    let (first, last) = (warm[0], warm[warm.len() - 1]);
    finding.expect(
        last.descriptors <= first.descriptors + DESCRIPTORS_MORE_MAX,
        || {
            format!(
                "{} descriptors have become {}",
                first.descriptors, last.descriptors
            )
        },
    );
    let log_bytes = warm
        .iter()
        .map(|sample| sample.log_bytes)
        .max()
        .unwrap_or(0);
    finding.expect(log_bytes <= LOG_BYTES_MAX, || {
        format!("the log has {} MB", log_bytes >> 20)
    });
    let growth = growth_mb_per_h(samples);
    finding.expect(form == Form::Quick || growth <= GROWTH_MAX_MB_PER_H, || {
        format!("memory grows by {growth:.1} MB an hour")
    });
    finding.faults
}

/// Slope of the resident memory after the warm-up, by least squares.
fn growth_mb_per_h(samples: &[Sample]) -> f64 {
    let warm = &samples[(WARM_UP_SHARE * samples.len() as f64) as usize..];
    let points = warm
        .iter()
        .map(|s| (s.at.as_secs_f64() / 3600.0, s.resident_bytes as f64 / 1e6));
    let count = warm.len() as f64;
    let (sum_x, sum_y) = points
        .clone()
        .fold((0.0, 0.0), |(x, y), point| (x + point.0, y + point.1));
    let (mean_x, mean_y) = (sum_x / count, sum_y / count);
    let (above, below) = points.fold((0.0, 0.0), |(above, below), (x, y)| {
        (
            above + (x - mean_x) * (y - mean_y),
            below + (x - mean_x).powi(2),
        )
    });
    if below == 0.0 { 0.0 } else { above / below }
}
