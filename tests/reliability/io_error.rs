//! A disk that fails for a moment, at any moment: what was acknowledged stays.
//!
//! `strace` counts calls by thread, and the service writes by a new thread after an error. The disk
//! is therefore well again once an upload was refused.

use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;

use crate::client::Client;
use crate::drives::{Batch, interleaved, two_vehicles};
use crate::gateway::{Acknowledged, Gateway};
use crate::kill;
use crate::oracle;
use crate::process::Process;
use crate::row::{Finding, Form, Row, run};
use crate::strace::{self, Strace};

pub const ROW: Row = Row {
    name: "io-error",
    shows: "EIO at the n-th sync or write of a thread (strace): nothing acknowledged is lost",
    obstacle: strace::obstacle,
    run: |form| run(io_error(form)),
};

/// The calls that fail.
const CALLS: [&str; 2] = ["fsync,fdatasync", "pwrite64"];
const QUICK: [usize; 3] = [1, 4, 11];
/// How often an upload is tried, and how long is waited between.
const TRIES: usize = 100;
const PAUSE: Duration = Duration::from_millis(50);

/// What became of one service.
struct Outcome {
    /// Calls that failed.
    injected: usize,
    /// Whether every upload was acknowledged in the end, without a restart.
    went_on: bool,
    /// Refusals and connections that broke.
    refusals: usize,
    acknowledged: usize,
    faults: Vec<String>,
}

async fn io_error(form: Form) -> Finding {
    let uploads = interleaved(&two_vehicles(200).map(|drive| drive.batches(2)));
    let places = form.choose(QUICK.to_vec(), (1..=200).collect());
    let mut finding = Finding {
        control: kill::control(&uploads[..20]).await,
        ..Finding::default()
    };
    for call in CALLS {
        let mut outcomes = Vec::new();
        for &place in &places {
            let uploads = &uploads[..uploads.len().min(place + 10)];
            let outcome = failing_at(call, place, uploads).await;
            let reported = outcome.faults.iter();
            finding
                .faults
                .extend(reported.map(|fault| format!("{call} {place}: {fault}")));
            outcomes.push(outcome);
        }
        let count = |of: fn(&Outcome) -> usize| outcomes.iter().map(of).sum::<usize>();
        let struck = count(|outcome| usize::from(outcome.injected > 0));
        finding.figure(format!(
            "{call}: {struck} of {} services struck ({} calls), {} batches acknowledged, {} refusals, \
             {} services went on without a restart",
            places.len(),
            count(|outcome| outcome.injected),
            count(|outcome| outcome.acknowledged),
            count(|outcome| outcome.refusals),
            count(|outcome| usize::from(outcome.went_on)),
        ));
        finding.expect(2 * struck > places.len(), || {
            format!("{call} hardly ever failed")
        });
    }
    finding
}

/// A service whose threads fail each at their n-th call, and what is left when it is restarted.
async fn failing_at(call: &str, place: usize, uploads: &[Batch]) -> Outcome {
    let directory = TempDir::new().unwrap();
    let data = directory.path().join("data");
    let mut process = Process::start(&data);
    Client::new(&process.url)
        .put_route("line", Value::Null)
        .await;
    let traced = format!("trace={call}");
    let inject = format!("inject={call}:error=EIO:when={place}");
    let arguments = ["-e", &traced, "-e", &inject];
    let mut strace = Strace::attach(process.id(), &arguments, &directory.path().join("trace"));
    let gateway = Gateway::new(&process.url);
    let (mut acknowledged, mut refusals, mut went_on) = (Acknowledged::default(), 0, true);
    for batch in uploads {
        let mut is_acknowledged = false;
        for _ in 0..TRIES {
            let answer = gateway.put("line", batch).await;
            is_acknowledged = answer.is_ok_and(|answer| answer.is_acknowledgement());
            if is_acknowledged {
                acknowledged.note("line", batch);
                break;
            }
            refusals += 1;
            strace.detach();
            tokio::time::sleep(PAUSE).await;
        }
        if !is_acknowledged {
            went_on = false;
            break;
        }
    }
    process.kill();
    let injected = strace.text().matches("(INJECTED)").count();
    let process = Process::start(&data);
    Outcome {
        injected,
        went_on,
        refusals,
        acknowledged: acknowledged.len(),
        faults: oracle::faults(&process.url, &data, &acknowledged).await,
    }
}
