//! Processes that are lost, and what they leave behind: jobs, a log, a clock that was ahead.
//!
//! With SQL past the store, for SQLite: files of a database, and a job that was tried before.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use mapshift::ids::RouteId;
use mapshift::model::BatchStatus::{self, Held, Merged, Quarantined, Queued, Unanchored};
use mapshift::store::{Applied, ClaimedJob, Store, StoreError};
use tempfile::TempDir;
use tokio::runtime::Runtime;

use crate::support::{Fixture, at, node, open, options, put_route, route, upload};

/// Runs a part of a store's life that ends without a word.
fn lose(directory: TempDir, life: impl AsyncFnOnce(&Fixture)) -> TempDir {
    let runtime = Runtime::new().unwrap();
    let directory = runtime.block_on(async {
        let store = open(&directory).await;
        put_route(&store, "r").await;
        let fixture = Fixture { store, directory };
        life(&fixture).await;
        fixture.directory
    });
    // The writer and everything else stop where they stand.
    drop(runtime);
    directory
}

fn ids(job: &ClaimedJob) -> Vec<&str> {
    job.entries.iter().map(|e| e.batch.id.as_str()).collect()
}

async fn end(fixture: &Fixture, job: &ClaimedJob, status: BatchStatus) {
    let result = fixture.result(job, status).await;
    let applied = fixture.store.apply_result(result).await.unwrap();
    assert_eq!(applied, Applied::Committed);
}

async fn journal_on(fixture: &Fixture, name: &str, id: &str) {
    put_route(&fixture.store, name).await;
    let mut batch = upload(id, "t", 0);
    batch.route_id = RouteId::new(name).unwrap();
    fixture.journal(batch).await;
}

#[test]
fn a_job_is_tried_again_alone_and_then_given_up() {
    let directory = lose(tempfile::tempdir().unwrap(), async |fixture| {
        fixture.journal(upload("poison", "t", 0)).await;
        fixture.journal(upload("later", "u", 0)).await;
        journal_on(fixture, "q", "beside").await;
        assert!(fixture.claim(0).await.is_some() && fixture.claim(0).await.is_some());
    });
    let directory = lose(directory, async |fixture| {
        journal_on(fixture, "s", "new").await;
        let new = fixture.claim(0).await.unwrap();
        assert_eq!(
            ids(&new),
            ["new"],
            "lost jobs wait, and what comes after them on their routes"
        );
        tokio::time::sleep(std::time::Duration::from_millis(1_100)).await;
        journal_on(fixture, "v", "newer").await;
        assert!(
            fixture.claim(0).await.is_none(),
            "nothing begins beside another job"
        );
        end(fixture, &new, Merged).await;
        let lost = fixture.claim(0).await.unwrap();
        assert_eq!((ids(&lost), lost.attempts), (vec!["poison"], 1));
        assert!(fixture.claim(0).await.is_none(), "nothing beside it");
    });
    let directory = lose(directory, async |fixture| {
        tokio::time::sleep(std::time::Duration::from_millis(1_100)).await;
        assert_eq!(fixture.status("poison").await, Queued);
        let beside = fixture.claim(0).await.unwrap();
        assert_eq!(
            ids(&beside),
            ["beside"],
            "poison waits longer the second time"
        );
        end(fixture, &beside, Merged).await;
        let mut raw = fixture.raw().await;
        let tried_twice_more = "UPDATE jobs SET orphaned = 3, state = 'running', \
                                lease_expires_us = 0, attempts = 1 WHERE orphaned = 2";
        let written = sqlx::query(tried_twice_more).execute(&mut raw).await;
        assert_eq!(written.unwrap().rows_affected(), 1);
    });
    Runtime::new().unwrap().block_on(async {
        let store = open(&directory).await;
        let fixture = Fixture { store, directory };
        let poison = fixture.batch("poison").await;
        assert_eq!(poison.status, Quarantined);
        assert!(poison.reason.unwrap().contains("lost 4 times"));
        assert_eq!(fixture.status("later").await, Queued);
        let first = fixture.claim(0).await.unwrap();
        assert_eq!(ids(&first), ["later"]);
        end(&fixture, &first, Merged).await;
        let second = fixture.claim(0).await.unwrap();
        assert_eq!(ids(&second), ["newer"]);
        end(&fixture, &second, Merged).await;
    });
}

#[test]
fn a_job_that_took_others_along_is_tried_without_them() {
    let directory = lose(tempfile::tempdir().unwrap(), async |fixture| {
        fixture.journal(upload("b0", "t", 0)).await;
        let job = fixture.claim(0).await.unwrap();
        end(fixture, &job, Unanchored).await;
        fixture.journal(upload("b1", "t", 1)).await;
        let job = fixture.claim(0).await.unwrap();
        assert_eq!((ids(&job), job.apart), (vec!["b0", "b1"], false));
    });
    Runtime::new().unwrap().block_on(async {
        let store = open(&directory).await;
        let fixture = Fixture { store, directory };
        let job = fixture.claim_lost().await;
        assert_eq!((ids(&job), job.apart), (vec!["b1"], true));
        end(&fixture, &job, Unanchored).await;
        fixture.journal(upload("b2", "t", 2)).await;
        let job = fixture.claim(0).await.unwrap();
        assert_eq!((ids(&job), job.apart), (vec!["b0", "b1", "b2"], false));
    });
}

#[tokio::test]
async fn an_orderly_end_is_nobodys_fault() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let Fixture {
        mut store,
        directory,
    } = fixture;
    for _ in 0..4 {
        let job = store.claim_job(at(0), crate::support::LEASE).await;
        assert_eq!(job.unwrap().unwrap().attempts, 1);
        store.close().await.unwrap();
        store = open(&directory).await;
    }
}

/// Bodies of 31 MiB: a job may load two of them.
#[tokio::test]
async fn a_long_trip_that_waits_goes_into_the_map_part_by_part() {
    let fixture = Fixture::new().await;
    for sequence in 0..5 {
        let mut batch = upload(&format!("b{sequence}"), "t", sequence);
        batch.body = vec![b' '; 31 << 20];
        fixture.journal(batch).await;
        match fixture.claim(1).await {
            Some(job) => {
                assert_eq!(job.entries.len() as i64, sequence + 1);
                assert!(sequence < 2);
                end(&fixture, &job, Unanchored).await;
            }
            None => assert!(sequence >= 2, "what was tried in vain is not tried again"),
        }
    }
    let waiting = fixture.batch("b4").await;
    assert_eq!(waiting.status, Unanchored);
    assert!(waiting.reason.unwrap().contains("follows"));

    fixture.journal(upload("big", "big", 0)).await;
    let job = fixture.claim(1).await.unwrap();
    let result = fixture.chain(&job, 100).await;
    fixture.store.apply_result(result).await.unwrap();
    for part in [vec!["b0", "b1"], vec!["b2", "b3"], vec!["b4"]] {
        let job = fixture.claim(1).await.unwrap();
        assert_eq!((ids(&job), job.after_gap), (part, false));
        let mut result = fixture.result(&job, Merged).await;
        let base = fixture.store.load_graph(&route()).await.unwrap().unwrap();
        result
            .nodes
            .push(node(&job.entries[0].batch, base.next_node_id.0));
        result.outcomes[0].nodes_added = 1;
        fixture.store.apply_result(result).await.unwrap();
    }
    assert!(fixture.claim(1).await.is_none());
    assert_eq!(fixture.status("b4").await, Merged);
}

#[tokio::test]
async fn a_batch_that_came_while_the_clock_was_ahead_is_held_no_longer_than_others() {
    let fixture = Fixture::new().await;
    let mut early = upload("b1", "t", 1);
    early.received_at = at(1_000_000);
    fixture.journal(early).await;
    assert_eq!(fixture.store.release_overdue(at(0)).await.unwrap(), 0);
    assert_eq!(fixture.store.release_overdue(at(599)).await.unwrap(), 0);
    assert_eq!(fixture.status("b1").await, Held);
    assert_eq!(fixture.store.release_overdue(at(600)).await.unwrap(), 1);
    // Its job fails while the clock is ahead again: it is not tried only when that time comes.
    let job = fixture.claim(1_000_000).await.unwrap();
    let (id, generation) = (job.job_id, job.generation);
    let failed = fixture.store.fail_job(id, generation, "why", at(1_000_000));
    failed.await.unwrap();
    assert!(fixture.claim(700).await.is_none());
    fixture.store.release_overdue(at(700)).await.unwrap();
    assert!(fixture.claim(700).await.is_some());
}

/// Copies what a killed process leaves, but for some files.
fn copy_without(from: &Path, left_out: &[&str]) -> TempDir {
    let to = tempfile::tempdir().unwrap();
    for file in std::fs::read_dir(from).unwrap() {
        let file = file.unwrap();
        if !left_out.contains(&file.file_name().to_str().unwrap()) {
            std::fs::copy(file.path(), to.path().join(file.file_name())).unwrap();
        }
    }
    to
}

#[tokio::test]
async fn a_lost_log_is_noticed_before_anything_is_written() {
    let fixture = Fixture::new().await;
    for k in 0..20 {
        fixture
            .journal(upload(&format!("b{k}"), &format!("t{k}"), 0))
            .await;
    }
    let data = fixture.directory.path();
    let whole = copy_without(data, &["mapshift.db-shm"]);
    let store = open(&whole).await;
    assert_eq!(
        store.route(&route()).await.unwrap().unwrap().counts.batches,
        20
    );
    store.close().await.unwrap();

    let log = std::fs::read(data.join("mapshift.db-wal")).unwrap();
    let without = copy_without(data, &["mapshift.db-shm", "mapshift.db-wal"]);
    let cut = copy_without(data, &["mapshift.db-shm"]);
    std::fs::write(
        cut.path().join("mapshift.db-wal"),
        &log[..log.len() * 9 / 10],
    )
    .unwrap();
    for lost in [without, cut] {
        for _ in 0..2 {
            let refused = Store::open(options(&lost)).await.err().unwrap();
            assert!(matches!(refused, StoreError::LostLog { .. }), "{refused}");
            assert!(refused.to_string().contains("--accept-lost-log"));
        }
        let store = Store::open_without_log(options(&lost)).await.unwrap();
        put_route(&store, "again").await;
        store.close().await.unwrap();
        open(&lost).await.close().await.unwrap();
    }
}

#[tokio::test]
async fn a_log_that_is_put_back_is_as_good_as_before() {
    let fixture = Fixture::new().await;
    fixture.journal(upload("b", "t", 0)).await;
    let data = fixture.directory.path();
    let lost = copy_without(data, &["mapshift.db-shm", "mapshift.db-wal"]);
    assert!(Store::open(options(&lost)).await.is_err());
    let log = "mapshift.db-wal";
    std::fs::copy(data.join(log), lost.path().join(log)).unwrap();
    let store = open(&lost).await;
    assert_eq!(
        store.route(&route()).await.unwrap().unwrap().counts.batches,
        1
    );
}

#[tokio::test]
async fn an_older_database_may_take_the_place_of_one_that_was_closed() {
    let fixture = Fixture::new().await;
    let Fixture { store, directory } = fixture;
    store.close().await.unwrap();
    let backup = std::fs::read(directory.path().join("mapshift.db")).unwrap();
    let store = open(&directory).await;
    store.journal_batch(upload("b", "t", 0)).await.unwrap();
    store.close().await.unwrap();
    assert!(!directory.path().join("mapshift.open").exists());
    std::fs::write(directory.path().join("mapshift.db"), backup).unwrap();
    open(&directory).await.close().await.unwrap();
}

#[tokio::test]
async fn files_are_their_owners_alone() {
    let Fixture { store, directory } = Fixture::new().await;
    let mode = |name: &str| {
        let metadata = std::fs::metadata(directory.path().join(name)).unwrap();
        metadata.permissions().mode() & 0o777
    };
    let names = [
        "mapshift.db",
        "mapshift.db-wal",
        "mapshift.db-shm",
        "mapshift.lock",
    ];
    for name in names
        .into_iter()
        .chain(["mapshift.open", "mapshift.reserve"])
    {
        assert_eq!(mode(name), 0o600, "{name}");
    }
    store.close().await.unwrap();
    let path = directory.path().join("mapshift.db");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    let store = open(&directory).await;
    for name in names {
        assert_eq!(mode(name), 0o600, "{name}");
    }
    store.close().await.unwrap();
}
