//! Drives a fleet against a service and says how it fares.
//!
//! `cargo run --release --example bench_load -- [VEHICLES [ROUTES [TRIPS [BEAMS]]]]` starts a
//! service of its own as a child process in a directory that goes with it, drives each vehicle's
//! trips through simulated halls, uploads them over HTTP, a batch after the other for each
//! vehicle, and prints scans a second from the first upload until everything is in the maps, the
//! service's processor time a scan, and how long the acknowledgements took.
//!
//! `bench_load stages [BEAMS]` prints instead what one scan costs on its way, stage by stage.

mod fleet;
mod service;
mod stages;

use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use reqwest::StatusCode;
use serde_json::{Value, json};

use fleet::{Fleet, Uploads};
use service::Service;

const POLL: Duration = Duration::from_millis(50);
const RETRY: Duration = Duration::from_millis(100);

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, or: usize| arguments.get(k).map_or(Ok(or), |text| text.parse());
    match arguments.first().map(String::as_str) {
        Some("serve") => runtime()?.block_on(service::serve()),
        Some("stages") => stages::print(number(1, 360)?),
        _ => {
            let fleet = Fleet {
                vehicles: number(0, 20)?,
                routes: number(1, 5)?,
                trips: number(2, 2)?,
                beams: number(3, 360)?,
            };
            runtime()?.block_on(drive(&fleet))
        }
    }
}

fn runtime() -> anyhow::Result<tokio::runtime::Runtime> {
    let mut builder = tokio::runtime::Builder::new_multi_thread();
    builder.enable_all().build().context("no runtime")
}

async fn drive(fleet: &Fleet) -> anyhow::Result<()> {
    let uploads = fleet.uploads()?;
    let batches: usize = uploads.iter().map(|vehicle| vehicle.batches.len()).sum();
    let scans: usize = uploads.iter().map(|vehicle| vehicle.scans).sum();
    let service = Service::start()?;
    let http = mapshift::http_client::builder().no_proxy().build()?;
    for route in 0..fleet.routes {
        let url = format!("{}/v1/routes/route-{route}", service.url);
        let answer = http.put(url).json(&json!({})).send().await?;
        anyhow::ensure!(answer.status().is_success(), "{}", answer.text().await?);
    }
    let before_s = service.processor_s()?;
    let begin = Instant::now();
    let mut sending = tokio::task::JoinSet::new();
    for vehicle in uploads {
        let (http, url) = (http.clone(), service.url.clone());
        sending.spawn(async move { send(&http, &url, vehicle).await });
    }
    let (mut waits_ms, mut refused) = (Vec::new(), 0);
    while let Some(sent) = sending.join_next().await {
        let sent = sent??;
        waits_ms.extend(sent.waits_ms);
        refused += sent.refused;
    }
    let sent_s = begin.elapsed().as_secs_f64();
    while pending(&http, &service.url).await? > 0 {
        tokio::time::sleep(POLL).await;
    }
    let settled_s = begin.elapsed().as_secs_f64();
    let processor_s = service.processor_s()? - before_s;
    let merged = merged(&http, &service.url, fleet.routes).await?;
    waits_ms.sort_by(f64::total_cmp);
    let wait = |share: f64| waits_ms[((waits_ms.len() - 1) as f64 * share) as usize];
    let scans_f = scans as f64;
    let mut console = std::io::stdout();
    writeln!(
        console,
        "{scans} scans of {} beams in {batches} batches from {} vehicles on {} routes, {merged} \
         batches merged, {refused} refused for a while",
        fleet.beams, fleet.vehicles, fleet.routes
    )?;
    writeln!(
        console,
        "sent in {sent_s:.2} s, settled in {settled_s:.2} s: {:.0} scans/s, {:.3} ms of processor \
         a scan, peak memory {}",
        scans_f / settled_s,
        1e3 * processor_s / scans_f,
        service.peak_memory()?
    )?;
    writeln!(
        console,
        "acknowledged in ms: median {:.1}, 99 % {:.1}, longest {:.1}",
        wait(0.5),
        wait(0.99),
        wait(1.0)
    )?;
    service.stop()
}

struct Sent {
    waits_ms: Vec<f64>,
    refused: usize,
}

/// Sends a vehicle's batches one after the other, each until it is stored.
async fn send(http: &reqwest::Client, url: &str, vehicle: Uploads) -> anyhow::Result<Sent> {
    let mut sent = Sent {
        waits_ms: Vec::new(),
        refused: 0,
    };
    for batch in vehicle.batches {
        let url = format!("{url}/v1/routes/{}/batches/{}", vehicle.route, batch.id);
        loop {
            let begin = Instant::now();
            let request = http.put(&url).body(batch.gzip.clone());
            let request = request
                .header("content-type", "application/json")
                .header("content-encoding", "gzip");
            let answer = request.send().await?;
            match answer.status() {
                StatusCode::ACCEPTED => {
                    sent.waits_ms.push(begin.elapsed().as_secs_f64() * 1e3);
                    break;
                }
                StatusCode::SERVICE_UNAVAILABLE => {
                    sent.refused += 1;
                    tokio::time::sleep(RETRY).await;
                }
                status => bail!("{status}: {}", answer.text().await?),
            }
        }
    }
    Ok(sent)
}

async fn items(http: &reqwest::Client, url: &str) -> anyhow::Result<Vec<Value>> {
    let (mut items, mut cursor) = (Vec::new(), String::new());
    loop {
        let page: Value = http
            .get(format!("{url}?limit=100{cursor}"))
            .send()
            .await?
            .json()
            .await?;
        items.extend(
            page["items"]
                .as_array()
                .context("no items")?
                .iter()
                .cloned(),
        );
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => return Ok(items),
        }
    }
}

async fn pending(http: &reqwest::Client, url: &str) -> anyhow::Result<i64> {
    let routes = items(http, &format!("{url}/v1/routes")).await?;
    let pending = routes
        .iter()
        .filter_map(|route| route["pending_batches"].as_i64());
    Ok(pending.sum())
}

async fn merged(http: &reqwest::Client, url: &str, routes: usize) -> anyhow::Result<usize> {
    let mut merged = 0;
    for route in 0..routes {
        let batches = items(http, &format!("{url}/v1/routes/route-{route}/batches")).await?;
        merged += batches.iter().filter(|b| b["status"] == "merged").count();
    }
    Ok(merged)
}
