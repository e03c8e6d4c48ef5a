//! A disk that fills up and is emptied again: uploads are refused meanwhile, and nothing else.

use std::time::{Duration, Instant};

use serde_json::Value;

use crate::client::Client;
use crate::drives::{Batch, two_vehicles};
use crate::gateway::{Acknowledged, Gateway};
use crate::oracle;
use crate::process::Process;
use crate::row::{Finding, Form, Row, run};
use crate::tmpfs::{self, Tmpfs};

pub const ROW: Row = Row {
    name: "disk-full",
    shows: "a full disk: reads go on, uploads get 507, DELETE works, and writing begins again by itself",
    obstacle: tmpfs::obstacle,
    run: |form| run(disk_full(form)),
};

/// Room for the service's reserve of 16 MiB, its log and its database.
const DISK_MIB: usize = 64;
const AGAIN_WITHIN: Duration = Duration::from_secs(2);
/// When nobody judges the time.
const PATIENCE: Duration = Duration::from_secs(20);
const REFUSALS: usize = 5;

/// A service on a small disk, and what it was sent.
struct Subject {
    // Ended before its disk is taken away.
    process: Process,
    disk: Tmpfs,
    uploads: std::vec::IntoIter<Batch>,
    acknowledged: Acknowledged,
    finding: Finding,
}

async fn disk_full(form: Form) -> Finding {
    let mut subject = Subject::new().await;
    let rounds = form.choose(1, 10);
    let (mut again_after, mut after_restart) = (Vec::new(), Vec::new());
    for round in 0..rounds {
        subject.disk.fill();
        subject.refuses_uploads_and_nothing_else().await;
        if round == 0 {
            subject.deletes().await;
            subject.finding.control = subject.control().await;
        }
        subject.disk.free();
        again_after.push(subject.writes_again(PATIENCE).await);

        subject.disk.fill();
        // What the service gave back of its reserve is taken as well.
        subject.refuses_uploads_and_nothing_else().await;
        subject.disk.fill();
        subject.process.kill();
        subject.process = Process::start(&subject.disk.path().join("data"));
        subject.refuses_uploads_and_nothing_else().await;
        subject.disk.free();
        after_restart.push(subject.writes_again(PATIENCE).await);
    }
    let data = subject.disk.path().join("data");
    let faults = oracle::faults(&subject.process.url, &data, &subject.acknowledged).await;
    let mut finding = subject.finding;
    finding.faults.extend(faults);
    for (what, times) in [
        ("", again_after),
        (" of a service that started on it", after_restart),
    ] {
        finding.expect(times.iter().all(Option::is_some), || {
            format!("with space again, writing{what} does not begin within {PATIENCE:?}")
        });
        let worst = times.into_iter().flatten().max().unwrap_or_default();
        finding.figure(format!(
            "writing{what} begins at most {} ms after there is space",
            worst.as_millis()
        ));
        finding.expect(form == Form::Quick || worst <= AGAIN_WITHIN, || {
            format!("writing{what} begins only after {worst:?}")
        });
    }
    finding.figure(format!(
        "{} batches acknowledged",
        subject.acknowledged.len()
    ));
    finding
}

impl Subject {
    async fn new() -> Self {
        let disk = Tmpfs::mount(DISK_MIB).unwrap();
        let process = Process::start(&disk.path().join("data"));
        let client = Client::new(&process.url);
        let [first, second] = two_vehicles(480);
        let uploads = second.batches(1);
        let mut acknowledged = Acknowledged::default();
        for route in ["line", "other"] {
            client.put_route(route, Value::Null).await;
            for batch in &first.batches(12)[..4] {
                client.put(route, batch).await;
                if route == "line" {
                    acknowledged.note(route, batch);
                }
            }
            client.merged(route).await;
        }
        Self {
            process,
            disk,
            uploads: uploads.into_iter(),
            acknowledged,
            finding: Finding::default(),
        }
    }

    /// While there is no space.
    async fn refuses_uploads_and_nothing_else(&mut self) {
        let gateway = Gateway::new(&self.process.url);
        for _ in 0..REFUSALS {
            let batch = self.uploads.next().unwrap();
            let answer = gateway.put("line", &batch).await.unwrap();
            if answer.is_acknowledgement() {
                self.acknowledged.note("line", &batch);
            }
            let is_refused = answer.status == 507 && answer.retry_after_s.is_some();
            self.finding
                .expect(is_refused, || format!("an upload got {answer:?}"));
        }
        for (path, expected) in [
            ("/readyz", 503),
            ("/livez", 200),
            ("/v1/routes/line", 200),
            ("/v1/routes/line/graph", 200),
            ("/v1/routes/line/map.png", 200),
        ] {
            let status = gateway.get(path).await.unwrap();
            self.finding
                .expect(status == expected, || format!("{path} got {status}"));
        }
    }

    async fn deletes(&mut self) {
        let gateway = Gateway::new(&self.process.url);
        let status = gateway.delete("/v1/routes/other").await.unwrap();
        let read = gateway.get("/v1/routes/other").await.unwrap();
        self.finding.expect((status, read) == (204, 404), || {
            format!("DELETE got {status}, and a read after it {read}")
        });
    }

    /// How long it takes until an upload is acknowledged; `None` if it is none in time.
    async fn writes_again(&mut self, patience: Duration) -> Option<Duration> {
        let gateway = Gateway::new(&self.process.url);
        let batch = self.uploads.next().unwrap();
        let began = Instant::now();
        while began.elapsed() < patience {
            if gateway
                .put("line", &batch)
                .await
                .unwrap()
                .is_acknowledgement()
            {
                let took = began.elapsed();
                self.acknowledged.note("line", &batch);
                return Some(took);
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        None
    }

    /// The disk stays full.
    async fn control(&mut self) -> Vec<String> {
        match self.writes_again(AGAIN_WITHIN).await {
            Some(_) => Vec::new(),
            None => vec![format!(
                "on a disk that stays full, writing does not begin within {AGAIN_WITHIN:?}"
            )],
        }
    }
}
