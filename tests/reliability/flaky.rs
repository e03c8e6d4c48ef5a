//! Gateways on a bad line: every batch is stored once, and the end is as on a good one.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;
use tokio::task::JoinSet;

use crate::client::Client;
use crate::drives::{Batch, interleaved, two_vehicles};
use crate::fsck;
use crate::gateway::{Gateway, address_of};
use crate::process::Process;
use crate::proxy::Proxy;
use crate::row::{Finding, Form, Row, nothing_in_the_way, run};
use crate::state::State;

pub const ROW: Row = Row {
    name: "flaky",
    shows: "gateways on a line that drops, doubles, cuts, resets, stalls and corrupts: stored once each",
    obstacle: nothing_in_the_way,
    run: |form| run(flaky(form)),
};

/// The route that is mapped; what is sent to the others waits for its trip's beginning.
const MAPPED: &str = "line";
const OTHERS: usize = 7;
const FAULTY_SHARE: f64 = 0.3;
const TRIES_MAX: usize = 60;
const PAUSE: Duration = Duration::from_millis(5);
/// What a bad line explains: a digest that does not match, a body too slow, a service that is busy.
const REPEATED: [u16; 4] = [400, 408, 429, 503];

/// What a service keeps of a route: sequence and number of scans of each batch, by id.
type Kept = BTreeMap<String, Vec<String>>;

/// What there was in the end.
struct End {
    kept: BTreeMap<String, Kept>,
    map: State,
    faults: Vec<String>,
    /// Requests that the line spoiled.
    spoiled: usize,
}

async fn flaky(form: Form) -> Finding {
    let batches = form.choose(200, 100_000);
    let uploads = uploads(batches);
    let clean = sent(&uploads, 0.0, TRIES_MAX).await;
    let flaky = sent(&uploads, FAULTY_SHARE, TRIES_MAX).await;
    let mut finding = Finding {
        faults: judged(&uploads, &flaky, &clean),
        ..Finding::default()
    };
    let stored: usize = flaky.kept.values().map(Kept::len).sum();
    finding.figure(format!(
        "{batches} batches, {stored} stored; {} requests spoiled on the way",
        flaky.spoiled
    ));
    let few = self::uploads(200);
    let no_retry = sent(&few, FAULTY_SHARE, 1).await;
    let clean = sent(&few, 0.0, TRIES_MAX).await;
    finding.control = judged(&few, &no_retry, &clean);
    finding
}

/// Batches by route: a drive that is mapped, and others that are only kept.
fn uploads(count: usize) -> BTreeMap<String, Vec<Batch>> {
    let drive = interleaved(&two_vehicles(24).map(|drive| drive.batches(2)));
    let body = two_vehicles(2)[0].batches(1).swap_remove(1).body;
    let body: Value = serde_json::from_slice(&body).unwrap();
    let mut uploads = BTreeMap::new();
    for number in 0..count - drive.len() {
        let mut body = body.clone();
        body["trip_id"] = format!("t-{number}").into();
        let batches: &mut Vec<Batch> = uploads
            .entry(format!("other-{}", number % OTHERS))
            .or_default();
        batches.push(Batch {
            id: format!("b-{number}"),
            body: serde_json::to_vec(&body).unwrap(),
        });
    }
    uploads.insert(MAPPED.to_owned(), drive);
    uploads
}

/// Sends everything over a line, a gateway for each route.
async fn sent(uploads: &BTreeMap<String, Vec<Batch>>, faulty_share: f64, tries: usize) -> End {
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    let client = Client::new(&process.url);
    let proxy = Proxy::start(address_of(&process.url), faulty_share, 11).await;
    let mut sending = JoinSet::new();
    for (route, batches) in uploads {
        client.put_route(route, Value::Null).await;
        let gateway = Gateway::of_one_request_each(&proxy.url);
        let (route, batches) = (route.clone(), batches.clone());
        sending.spawn(async move {
            let mut faults = Vec::new();
            for batch in &batches {
                faults.extend(send(&gateway, &route, batch, tries).await);
            }
            faults
        });
    }
    let mut faults: Vec<String> = sending.join_all().await.concat();
    client.settled(MAPPED, false).await;
    let mut kept = BTreeMap::new();
    for route in uploads.keys() {
        let batches = client
            .list(&format!("/v1/routes/{route}/batches"), 1000)
            .await;
        kept.insert(route.clone(), kept_of(&batches));
    }
    faults.extend(fsck::faults(directory.path()));
    End {
        kept,
        map: State::of(&client, MAPPED).await,
        faults,
        spoiled: proxy.faults(),
    }
}

fn kept_of(batches: &[Value]) -> Kept {
    let mut kept = Kept::new();
    for batch in batches {
        let reported =
            ["trip_id", "sequence", "scans", "status"].map(|field| batch[field].to_string());
        let of_id = kept
            .entry(batch["id"].as_str().unwrap().to_owned())
            .or_default();
        of_id.push(reported.join(" "));
    }
    kept
}

/// Sends a batch until it is acknowledged; why it is not, if it never is.
async fn send(gateway: &Gateway, route: &str, batch: &Batch, tries: usize) -> Option<String> {
    for _ in 0..tries {
        match gateway.put(route, batch).await {
            Ok(answer) if answer.is_acknowledgement() => return None,
            Ok(answer) if !REPEATED.contains(&answer.status) => {
                return Some(format!("{} got {answer:?}", batch.id));
            }
            Ok(_) | Err(_) => tokio::time::sleep(PAUSE).await,
        }
    }
    Some(format!(
        "{} was not acknowledged in {tries} tries",
        batch.id
    ))
}

fn judged(uploads: &BTreeMap<String, Vec<Batch>>, end: &End, clean: &End) -> Vec<String> {
    let mut faults = end.faults.clone();
    for (route, batches) in uploads {
        let kept = &end.kept[route];
        for batch in batches {
            match kept.get(&batch.id).map_or(0, Vec::len) {
                1 => {}
                times => faults.push(format!("{} is stored {times} times", batch.id)),
            }
        }
        if *kept != clean.kept[route] {
            faults.push(format!(
                "what is kept of {route} is not what a good line leaves"
            ));
        }
    }
    if end.map != clean.map {
        faults.push("the map is not what a good line leaves".to_owned());
    }
    faults
}
