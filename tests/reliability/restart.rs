//! A service with much behind it, or much in its log, is soon ready again.
//!
//! What it starts on is written through the library's store: a million scans as nodes of a route,
//! with their scans and edges, and a log that a reader kept from being moved into the database.

use std::path::Path;
use std::time::Duration;

use mapshift::model::BatchStatus;
use mapshift::store::{BatchContent, NewBatch};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sqlx::SqliteConnection;
use tempfile::TempDir;

use crate::client::Client;
use crate::fsck;
use crate::ready;
use crate::row::{Finding, Form, Row, nothing_in_the_way, run};
use crate::support::{Fixture, edge, node, upload};

pub const ROW: Row = Row {
    name: "restart",
    shows: "a service with a million scans, or a log of 1 GB, is soon ready again with all of it",
    obstacle: nothing_in_the_way,
    run: |form| run(restart(form)),
};

const SCANS_A_BATCH: i64 = 1_000;
/// About as long as the compact form of 360 beams.
const SCAN_BYTES: usize = 720;
const BODY_BYTES: usize = 100_000;
const LOG_BODY_BYTES: usize = 4 << 20;
const LOG: &str = "mapshift.db-wal";
/// Files that a copy of what a killed process leaves does without: SQLite makes it again.
const INDEX_OF_LOG: &str = "mapshift.db-shm";

async fn restart(form: Form) -> Finding {
    let mut finding = Finding::default();
    let scans = form.choose(5_000, 1_000_000);
    let directory = with_scans(scans).await;
    let what = format!("with {scans} scans");
    let ready_within = Duration::from_secs(1);
    for after in ["an orderly end", "a kill"] {
        let what = format!("{what}, after {after}");
        judge(form, directory.path(), &what, ready_within, &mut finding).await;
    }
    let log_bytes = form.choose(20 << 20, 1 << 30);
    let (directory, batches) = with_log(log_bytes).await;
    let lost = copy_without(directory.path(), &[INDEX_OF_LOG, LOG]);
    let what = format!("with a log of {} MB", log_bytes >> 20);
    judge(
        form,
        directory.path(),
        &what,
        Duration::from_secs(2),
        &mut finding,
    )
    .await;
    finding.faults.extend(fsck::faults(directory.path()));
    let (process, _) = ready::start(directory.path()).await.unwrap();
    let kept = Client::new(&process.url).route("r").await["counts"]["batches"].clone();
    finding.expect(kept == batches, || {
        format!("of {batches} batches in the log {kept} are there")
    });

    let mut control = Finding::default();
    judge(
        form,
        lost.path(),
        "without its log",
        ready_within,
        &mut control,
    )
    .await;
    finding.control = control.faults;
    finding
}

/// Starts a service, notes how long it took, and kills it.
async fn judge(form: Form, data: &Path, what: &str, within: Duration, finding: &mut Finding) {
    let Some((_process, took)) = ready::start(data).await else {
        finding.faults.push(format!("{what} it is never ready"));
        return;
    };
    finding.figure(format!("{what}: ready after {} ms", took.as_millis()));
    finding.expect(form == Form::Quick || took <= within, || {
        format!("{what} it is ready only after {took:?}")
    });
}

fn noise(bytes: usize, seed: u64) -> Vec<u8> {
    let mut noise = vec![0; bytes];
    ChaCha8Rng::seed_from_u64(seed).fill_bytes(&mut noise);
    noise
}

/// A data directory whose one route has this many nodes, each with a scan, closed in order.
async fn with_scans(scans: i64) -> TempDir {
    let fixture = Fixture::new().await;
    for batch in 0..scans / SCANS_A_BATCH {
        let own = NewBatch {
            content: BatchContent::Scans {
                sequence: 0,
                scans: SCANS_A_BATCH,
            },
            body: noise(BODY_BYTES, batch as u64),
            ..upload(&format!("b{batch}"), &format!("t{batch}"), 0)
        };
        fixture.journal(own).await;
        let job = fixture.claim(0).await.unwrap();
        let mut result = fixture.result(&job, BatchStatus::Merged).await;
        let record = &job.entries[0].batch;
        for k in 0..SCANS_A_BATCH {
            let id = 1 + batch * SCANS_A_BATCH + k;
            let mut node = node(record, id);
            node.scan = Some(noise(SCAN_BYTES, id as u64));
            result.nodes.push(node);
            if k > 0 {
                let edge_id = batch * (SCANS_A_BATCH - 1) + k;
                result.edges.push(edge(record, edge_id, id - 1, id));
            }
        }
        result.outcomes[0].nodes_added = SCANS_A_BATCH;
        fixture.store.apply_result(result).await.unwrap();
    }
    let Fixture { store, directory } = fixture;
    store.close().await.unwrap();
    directory
}

/// What a process leaves that was killed with such a log, and how many batches it has.
async fn with_log(bytes: u64) -> (TempDir, i64) {
    let fixture = Fixture::new().await;
    let _reader = pin(fixture.raw().await).await;
    let log = fixture.directory.path().join(LOG);
    let mut batches = 0;
    while std::fs::metadata(&log).unwrap().len() < bytes {
        let mut batch = upload(&format!("b{batches}"), &format!("t{batches}"), 1);
        batch.body = noise(LOG_BODY_BYTES, batches as u64);
        fixture.journal(batch).await;
        batches += 1;
    }
    (
        copy_without(fixture.directory.path(), &[INDEX_OF_LOG]),
        batches,
    )
}

/// A reader that stays where the database is now: nothing that comes later is moved into it.
async fn pin(mut reader: SqliteConnection) -> SqliteConnection {
    sqlx::query("BEGIN").execute(&mut reader).await.unwrap();
    let read = sqlx::query("SELECT count(*) FROM batches");
    read.execute(&mut reader).await.unwrap();
    reader
}

fn copy_without(from: &Path, left_out: &[&str]) -> TempDir {
    let to = TempDir::new().unwrap();
    for file in std::fs::read_dir(from).unwrap() {
        let file = file.unwrap();
        if !left_out.contains(&file.file_name().to_str().unwrap()) {
            std::fs::copy(file.path(), to.path().join(file.file_name())).unwrap();
        }
    }
    to
}
