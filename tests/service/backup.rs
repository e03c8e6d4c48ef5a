//! `mapshift backup` and `mapshift restore`: what was acknowledged before a backup is in it.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;
use tempfile::TempDir;
use tokio::sync::mpsc;

use crate::changes::{ROUTE, Shop};
use crate::client::Client;
use crate::process::Process;

fn mapshift(arguments: &[&str], paths: &[&Path]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mapshift"));
    command.args(arguments);
    for pair in paths {
        command.arg(pair);
    }
    command.output().unwrap()
}

fn back_up(data: &Path, output: &Path) -> Output {
    let data = data.to_str().unwrap();
    mapshift(&["backup", "--data", data, "--output"], &[output])
}

fn restore(file: &Path, data: &Path, more: &[&str]) -> Output {
    let data = data.to_str().unwrap();
    let arguments = [&["restore", "--data", data], more].concat();
    mapshift(&arguments, &[file])
}

/// Whether it ended well, and what it wrote.
fn outcome(output: &Output) -> (bool, String) {
    let text = [&output.stdout[..], &output.stderr[..]].concat();
    let text = String::from_utf8(text).unwrap();
    (output.status.success(), text)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_acknowledged_before_a_backup_is_in_it() {
    let directory = TempDir::new().unwrap();
    let data = directory.path().join("data");
    let mut service = Process::start(&data);
    let client = Client::new(&service.url);
    client.put_route(ROUTE, Value::Null).await;

    let (acknowledged, mut seen) = mpsc::unbounded_channel();
    let uploading = tokio::spawn({
        let client = client.clone();
        async move {
            let shop = Shop::new(5);
            for batch in (0..12).flat_map(|lap| shop.lap(lap)) {
                client.put(ROUTE, &batch).await;
                // Nobody listens any more once the backup is there.
                let _ = acknowledged.send(batch.id);
            }
        }
    });
    let mut before = Vec::new();
    while before.len() < 4 {
        before.push(seen.recv().await.unwrap());
    }
    while let Ok(id) = seen.try_recv() {
        before.push(id);
    }
    let file = directory.path().join("b.db");
    let (data_too, file_too) = (data.clone(), file.clone());
    let made = tokio::task::spawn_blocking(move || back_up(&data_too, &file_too));
    let (ended_well, text) = outcome(&made.await.unwrap());
    assert!(ended_well && text.contains("1 routes"), "{text}");
    uploading.await.unwrap();

    // In use, then in the way, then kept aside.
    let (ended_well, text) = outcome(&restore(&file, &data, &["--replace"]));
    assert!(!ended_well && text.contains("in use"), "{text}");
    service.kill();
    let (ended_well, text) = outcome(&restore(&file, &data, &[]));
    assert!(!ended_well && text.contains("--replace"), "{text}");
    let whole = std::fs::metadata(data.join("mapshift.db")).unwrap().len();
    let (ended_well, text) = outcome(&restore(&file, &data, &["--replace"]));
    assert!(ended_well && text.contains("send again"), "{text}");
    let aside = std::fs::read_dir(&data).unwrap().map(|e| e.unwrap().path());
    let aside: Vec<_> = aside.filter(|path| path.is_dir()).collect();
    assert_eq!(aside.len(), 1, "{aside:?}");
    let kept = std::fs::metadata(aside[0].join("mapshift.db"))
        .unwrap()
        .len();
    assert_eq!(kept, whole);

    let data_text = data.to_str().unwrap();
    let checked = mapshift(&["fsck", "--full", "--data", data_text], &[]);
    assert!(checked.status.success(), "{:?}", outcome(&checked));
    let service = Process::start(&data);
    let client = Client::new(&service.url);
    for id in &before {
        assert_eq!(client.batch(ROUTE, id).await["id"], id.as_str());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_that_lost_its_log_is_not_backed_up() {
    let directory = TempDir::new().unwrap();
    let (data, file) = (directory.path().join("data"), directory.path().join("b.db"));
    let mut service = Process::start(&data);
    Client::new(&service.url)
        .put_route(ROUTE, Value::Null)
        .await;
    service.kill();
    std::fs::remove_file(data.join("mapshift.db-wal")).unwrap();
    let (ended_well, text) = outcome(&back_up(&data, &file));
    assert!(!ended_well && text.contains("commits"), "{text}");
    assert!(!file.exists(), "nothing that looks like a backup");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unsound_backup_is_not_restored() {
    let directory = TempDir::new().unwrap();
    let (data, file) = (directory.path().join("data"), directory.path().join("b.db"));
    let mut service = Process::start(&data);
    Client::new(&service.url)
        .put_route(ROUTE, Value::Null)
        .await;
    assert!(outcome(&back_up(&data, &file)).0);
    service.kill();
    let (ended_well, text) = outcome(&back_up(&data, &file));
    assert!(
        !ended_well && text.contains("nothing is overwritten"),
        "{text}"
    );
    let fresh = directory.path().join("fresh");

    let bytes = std::fs::read(&file).unwrap();
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 1;
    std::fs::write(&file, damaged).unwrap();
    let (ended_well, text) = outcome(&restore(&file, &fresh, &[]));
    assert!(!ended_well && text.contains("SHA-256"), "{text}");
    std::fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    std::fs::remove_file(directory.path().join("b.db.sha256")).unwrap();
    let (ended_well, text) = outcome(&restore(&file, &fresh, &[]));
    assert!(!ended_well, "{text}");
    std::fs::write(&file, "not a database at all, whatever its name").unwrap();
    let (ended_well, text) = outcome(&restore(&file, &fresh, &[]));
    assert!(!ended_well && text.contains("not a database"), "{text}");

    std::fs::write(&file, &bytes).unwrap();
    let mut raw = SqliteConnectOptions::new()
        .filename(&file)
        .connect()
        .await
        .unwrap();
    sqlx::query(
        "UPDATE _sqlx_migrations SET version = 9999 \
         WHERE version = (SELECT max(version) FROM _sqlx_migrations)",
    )
    .execute(&mut raw)
    .await
    .unwrap();
    drop(raw);
    let (ended_well, text) = outcome(&restore(&file, &fresh, &[]));
    assert!(
        !ended_well && text.contains("newer than this program"),
        "{text}"
    );
    assert!(!fresh.exists(), "a refusal leaves nothing behind");
}
