//! No upload is acknowledged before it is on the disk: as the kernel sees it.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;
use tempfile::TempDir;

use crate::client::{Client, Put};
use crate::drives::{Batch, two_vehicles};
use crate::process::Process;
use crate::row::{Finding, Form, Row, run};
use crate::strace::{self, Strace};

pub const ROW: Row = Row {
    name: "acknowledgement",
    shows: "between the log's write of a batch and its 202 the log is synced (strace)",
    obstacle: strace::obstacle,
    run: acknowledgement,
};

/// Calls that write and sync, with enough of what is written to find a batch's name in it.
const TRACED: [&str; 4] = [
    "-s",
    "8192",
    "-e",
    "trace=pwrite64,write,writev,sendto,sendmsg,fdatasync,fsync",
];
const LOG: &str = "mapshift.db-wal>";
const ANSWER: &str = "\"HTTP/1.1 202 ";
const SYNCS: [&str; 2] = ["fdatasync", "fsync"];

fn acknowledgement(form: Form) -> Finding {
    let [first, _] = two_vehicles(form.choose(60, 1_200));
    let batches = first.batches(3);
    let trace = run(trace_of(&batches));
    let (faults, answers) = judged(&trace, &batches);
    let mut finding = Finding {
        faults,
        ..Finding::default()
    };
    let syncs = trace.lines().filter(|line| is_sync(line)).count();
    finding.figure(format!(
        "{answers} acknowledgements, each after the sync of its own write; {syncs} lines of syncs"
    ));
    let unsynced: Vec<&str> = trace.lines().filter(|line| !is_sync(line)).collect();
    let (control, _) = judged(&unsynced.join("\n"), &batches);
    finding.control = control;
    finding
}

async fn trace_of(batches: &[Batch]) -> String {
    let directory = TempDir::new().unwrap();
    let mut process = Process::start(&directory.path().join("data"));
    let client = Client::new(&process.url);
    client.put_route("line", Value::Null).await;
    let strace = Strace::attach(process.id(), &TRACED, &directory.path().join("trace"));
    for batch in batches {
        assert_eq!(client.put("line", batch).await, Put::Stored);
    }
    process.kill();
    strace.text()
}

fn is_sync(line: &str) -> bool {
    SYNCS.iter().any(|sync| line.contains(sync))
}

/// What of a trace contradicts the promise, and how many acknowledgements it has. The batches were
/// sent one after the other.
fn judged(trace: &str, batches: &[Batch]) -> (Vec<String>, usize) {
    let mut written: BTreeSet<&str> = BTreeSet::new();
    let mut synced: BTreeSet<&str> = BTreeSet::new();
    // What had been written when a thread's sync began.
    let mut syncing: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    let mut answered = batches.iter();
    let (mut faults, mut answers) = (Vec::new(), 0);
    for line in trace.lines() {
        let Some((thread, call)) = line.split_once(' ') else {
            continue;
        };
        let call = call.trim_start();
        if call.starts_with("pwrite64(") && call.contains(LOG) {
            let is_named = |batch: &&Batch| call.contains(&batch.id);
            written.extend(
                batches
                    .iter()
                    .filter(is_named)
                    .map(|batch| batch.id.as_str()),
            );
        } else if is_sync(call) {
            if !call.starts_with("<...") && call.contains(LOG) {
                syncing.insert(thread, written.clone());
            }
            if call.ends_with("= 0") {
                synced.extend(syncing.remove(thread).unwrap_or_default());
            }
        } else if call.contains(ANSWER) {
            answers += 1;
            match answered.next() {
                Some(batch) if synced.contains(batch.id.as_str()) => {}
                Some(batch) => faults.push(format!("{} was acknowledged unsynced", batch.id)),
                None => faults.push("there are more acknowledgements than batches".to_owned()),
            }
        }
    }
    let missing = answered.count();
    if missing > 0 {
        faults.push(format!("{missing} acknowledgements are not in the trace"));
    }
    (faults, answers)
}
