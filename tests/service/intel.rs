//! The Intel Research Lab log, as a user uploads it; skipped where `MAPSHIFT_DATA` is not set.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;

use crate::client::Client;
use crate::process::Process;
use crate::state::State;

fn log_file() -> Option<PathBuf> {
    let data = std::env::var_os("MAPSHIFT_DATA");
    if data.is_none() {
        eprintln!("skipped: MAPSHIFT_DATA is not set");
    }
    Some(PathBuf::from(data?).join("logs/intel.log.gz"))
}

fn upload(url: &str, file: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_mapshift"))
        .args(["upload", "--wait", "--route", "lab", "--vehicle", "pioneer"])
        .args(["--batch-scans", "20", "--url", url])
        .arg(file)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

fn said(upload: Child) -> String {
    let output = upload.wait_with_output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}");
    text
}

/// An address that a service can have again after it was killed.
fn free_address() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().to_string()
}

/// `MAPSHIFT_DATA=… cargo test --test service -- --ignored intel`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes half a minute"]
async fn an_upload_outlives_the_service_it_began_with() {
    let Some(file) = log_file() else { return };
    let undisturbed = {
        let directory = TempDir::new().unwrap();
        let process = Process::start(directory.path());
        let text = said(upload(&process.url, &file));
        assert!(text.contains("stored 46 batches (910 scans)"), "{text}");
        State::of(&Client::new(&process.url), "lab").await
    };
    assert!(undisturbed.nodes.len() > 500);

    let directory = TempDir::new().unwrap();
    let address = free_address();
    let mut process = Process::start_on(&address, directory.path());
    let uploading = upload(&process.url, &file);
    for wait_ms in [300, 900, 1_700] {
        tokio::time::sleep(Duration::from_millis(wait_ms)).await;
        process.kill();
        process = Process::start_on(&address, directory.path());
    }
    said(uploading);
    let client = Client::new(&process.url);
    assert!(State::of(&client, "lab").await == undisturbed);
    let text = said(upload(&process.url, &file));
    assert!(text.contains("stored 0 batches"), "{text}");
    assert!(text.contains("46 were there already"), "{text}");

    let total = |field: &str| -> f64 {
        let values = undisturbed.edges.iter().map(|edge| &edge[field]);
        values.filter_map(Value::as_f64).sum()
    };
    let (residual, added) = (total("residual"), total("delta_f"));
    assert!(
        (residual - added).abs() <= 1e-6 * residual,
        "{residual} {added}"
    );
}
