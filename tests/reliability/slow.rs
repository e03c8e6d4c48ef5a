//! Clients that hold connections, and bodies that grow: closed and refused, and nobody else waits.

use std::net::{Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::client::Client;
use crate::drives::{Batch, two_vehicles};
use crate::gateway::{Gateway, address_of};
use crate::latency::Latencies;
use crate::process::Process;
use crate::row::{Finding, Form, Row, run};
use crate::stub;

pub const ROW: Row = Row {
    name: "slow",
    shows: "slow connections are closed, bombs are refused, and honest gateways do not notice",
    obstacle,
    run: |form| run(slow(form)),
};

/// When a connection that says nothing must be closed.
const CLOSED_WITHIN: Duration = Duration::from_secs(6);
/// The same when times are not judged.
const CLOSED_AT_LAST: Duration = Duration::from_secs(15);
const BOMB_WITHIN: Duration = Duration::from_millis(250);
const HONEST_WITHIN: Duration = Duration::from_millis(100);
const HONEST_PAUSE: Duration = Duration::from_millis(20);
/// This many connections come from one address: less than its share.
const PER_ADDRESS: usize = 250;
const BOMBS: usize = 64;
/// Uploads under way of one address: half its share.
const BOMBS_PER_ADDRESS: usize = 16;

/// Why it cannot run here, if it cannot: not every system has all of 127.0.0.0/8.
fn obstacle() -> Option<String> {
    let bound = std::net::TcpListener::bind((Ipv4Addr::new(127, 0, 3, 1), 0));
    let why = |error| format!("clients cannot have addresses like 127.0.3.1 here: {error}");
    bound.err().map(why)
}

async fn slow(form: Form) -> Finding {
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    let client = Client::new(&process.url);
    client.put_route("line", Value::Null).await;
    let address = address_of(&process.url);
    let honest = Honest::start(&process.url);
    let mut finding = Finding::default();

    let patience = form.choose(CLOSED_AT_LAST, CLOSED_WITHIN);
    let connections = form.choose(100, 1_000);
    let silent = address_of(&stub::silent().await);
    let (closed, control) = tokio::join!(
        slow_connections(address, connections, patience),
        slow_connections(silent, 2, CLOSED_WITHIN),
    );
    let (worst, faults) = closed;
    finding.faults.extend(faults);
    finding.control = control.1;
    finding.figure(format!(
        "{connections} slow connections closed after {:.1} s at most",
        worst.as_secs_f64()
    ));
    judge_honest(form, "slow connections", honest.end().await, &mut finding);

    let honest = Honest::start(&process.url);
    let refusals = bombs(&process.url, form.choose(16, BOMBS)).await;
    let mut took = Latencies::default();
    refusals.iter().for_each(|(_, time)| took.note(*time));
    let statuses = refusals.iter().map(|(status, _)| *status);
    let others: Vec<u16> = statuses.filter(|status| *status != 413).collect();
    finding.expect(others.is_empty(), || format!("bombs got {others:?}"));
    let worst = took.quantile(1.0);
    finding.figure(format!(
        "{} bombs at once: 413 after {} ms (median), {} ms (worst)",
        refusals.len(),
        took.quantile(0.5).as_millis(),
        worst.as_millis()
    ));
    finding.expect(form == Form::Quick || worst <= BOMB_WITHIN, || {
        format!("a bomb was refused only after {worst:?}")
    });
    judge_honest(form, "bombs", honest.end().await, &mut finding);
    finding
}

fn judge_honest(
    form: Form,
    beside: &str,
    (took, refused): (Latencies, Vec<u16>),
    finding: &mut Finding,
) {
    let p99 = took.quantile(0.99);
    finding.figure(format!(
        "beside {beside}: {} honest requests, p99 {:.1} ms, worst {:.1} ms",
        took.count(),
        1e3 * p99.as_secs_f64(),
        1e3 * took.quantile(1.0).as_secs_f64()
    ));
    finding.expect(refused.is_empty(), || {
        let count = refused.len();
        format!(
            "beside {beside}, {count} honest requests were refused, the first with {}",
            refused[0]
        )
    });
    finding.expect(form == Form::Quick || p99 <= HONEST_WITHIN, || {
        format!("beside {beside}, honest requests take {p99:?} (p99)")
    });
}

/// When the last of them was closed, and what was wrong. A tenth, from one address, send a part of an
/// upload, of which the service takes only that address's share; the others send half a head.
async fn slow_connections(
    service: SocketAddr,
    count: usize,
    patience: Duration,
) -> (Duration, Vec<String>) {
    let mut held = JoinSet::new();
    for number in 0..count {
        let source = Ipv4Addr::new(127, 0, 3, 1 + (number / PER_ADDRESS) as u8);
        let says = match number < count / 10 {
            true => {
                "PUT /v1/routes/line/batches/slow HTTP/1.1\r\nhost: localhost\r\n\
                  content-type: application/json\r\ncontent-length: 9000\r\n\r\n{"
            }
            false => "GET /livez HTTP/1.1\r\nhost: te",
        };
        let mut connection = connect(source, service).await;
        connection.write_all(says.as_bytes()).await.unwrap();
        let began = Instant::now();
        held.spawn(async move {
            let mut answer = Vec::new();
            // A reset closes it as well.
            let closed = tokio::time::timeout(patience, connection.read_to_end(&mut answer)).await;
            closed.is_ok().then(|| began.elapsed())
        });
    }
    let closed = held.join_all().await;
    let open = closed.iter().filter(|after| after.is_none()).count();
    let worst = closed.into_iter().flatten().max().unwrap_or_default();
    let faults = match open {
        0 => Vec::new(),
        open => vec![format!(
            "{open} of {count} slow connections are open after {patience:?}"
        )],
    };
    (worst, faults)
}

async fn connect(source: Ipv4Addr, service: SocketAddr) -> TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind((source, 0).into()).unwrap();
    socket.connect(service).await.unwrap()
}

/// Bodies of 60 MB of blanks in a few bytes, all at once: statuses and times.
async fn bombs(url: &str, count: usize) -> Vec<(u16, Duration)> {
    let body = zstd::bulk::compress(&vec![b' '; 60 << 20], 1).unwrap();
    let mut sent = JoinSet::new();
    for number in 0..count {
        let source = Ipv4Addr::new(127, 0, 4, 1 + (number / BOMBS_PER_ADDRESS) as u8);
        let gateway = Gateway::from_address(url, source.into());
        let bomb = Batch {
            id: format!("bomb-{number}"),
            body: body.clone(),
        };
        sent.spawn(async move {
            let began = Instant::now();
            let answer = gateway.put_encoded("line", &bomb, "zstd").await.unwrap();
            (answer.status, began.elapsed())
        });
    }
    sent.join_all().await
}

/// A gateway and a reader from an address of their own, one request after the other.
struct Honest {
    stop: CancellationToken,
    task: tokio::task::JoinHandle<(Latencies, Vec<u16>)>,
}

impl Honest {
    fn start(url: &str) -> Self {
        let stop = CancellationToken::new();
        let gateway = Gateway::from_address(url, Ipv4Addr::new(127, 0, 2, 1).into());
        let stopped = stop.clone();
        let task = tokio::spawn(async move {
            let (mut took, mut refused) = (Latencies::default(), Vec::new());
            // Without the first batch of the trip the others are held: uploads alone are measured.
            let uploads = two_vehicles(240)[0].batches(12);
            for batch in uploads.iter().skip(1).cycle() {
                if stopped.is_cancelled() {
                    break;
                }
                let began = Instant::now();
                let status = gateway.put("line", batch).await.unwrap().status;
                took.note(began.elapsed());
                let began = Instant::now();
                let read = gateway.get("/v1/routes/line").await.unwrap();
                took.note(began.elapsed());
                refused.extend(
                    [status, read]
                        .into_iter()
                        .filter(|s| ![200, 202].contains(s)),
                );
                tokio::time::sleep(HONEST_PAUSE).await;
            }
            (took, refused)
        });
        Self { stop, task }
    }

    async fn end(self) -> (Latencies, Vec<u16>) {
        self.stop.cancel();
        self.task.await.unwrap()
    }
}
