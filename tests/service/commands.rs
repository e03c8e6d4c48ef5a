//! `mapshift config` and `mapshift doctor`, as an operator runs them.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;
use tempfile::TempDir;

use crate::changes::ROUTE;
use crate::client::Client;
use crate::process::Process;

fn run(arguments: &[&str], variables: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mapshift"));
    command.args(arguments).envs(variables.iter().copied());
    command.output().unwrap()
}

#[test]
fn a_flag_beats_a_variable_and_that_the_file() {
    let directory = TempDir::new().unwrap();
    let file = directory.path().join("mapshift.toml");
    std::fs::write(
        &file,
        "log = \"info\"\nmap_memory_mb = 1\nkeep-bodies-days = 2\naddress-share = 3\n",
    )
    .unwrap();
    let file = file.to_str().unwrap();
    let variables = [
        ("MAPSHIFT_CONFIG", file),
        ("MAPSHIFT_MAP_MEMORY_MB", "10"),
        ("MAPSHIFT_KEEP_BODIES_DAYS", "20"),
    ];
    let output = run(&["config", "--json", "--map-memory-mb", "100"], &variables);
    let settings: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
    let of = |name: &str| {
        let setting = settings.iter().find(|setting| setting["name"] == name);
        let setting = setting.unwrap();
        json!([setting["value"], setting["source"], setting["line"]])
    };
    assert_eq!(of("map-memory-mb"), json!(["100", "flag", null]));
    assert_eq!(of("keep-bodies-days"), json!(["20", "variable", null]));
    assert_eq!(of("address-share"), json!(["3", "file", 4]));
    assert_eq!(of("log-format"), json!(["text", "default", null]));

    // What is no setting stops every command that takes the file.
    std::fs::write(file, "adress-share = 3\n").unwrap();
    for command in ["serve", "fsck", "config"] {
        let output = run(&[command, "--config", file], &[]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success());
        assert!(
            said.contains("line 1: there is no setting adress-share; is it address-share?"),
            "{said}"
        );
    }
}

#[test]
fn a_command_takes_the_data_directory_from_the_file() {
    let directory = TempDir::new().unwrap();
    let file = directory.path().join("mapshift.toml");
    let data = directory.path().join("elsewhere");
    std::fs::write(
        &file,
        format!("listen = \"127.0.0.1:0\"\ndata = {data:?}\n"),
    )
    .unwrap();
    let file = file.to_str().unwrap();
    let output = run(&["fsck", "--config", file], &[]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("elsewhere"), "{said}");
    // This one makes it.
    let output = run(&["keys", "list", "--config", file], &[]);
    assert!(output.status.success() && data.is_dir(), "{output:?}");
}

/// The exit code of `mapshift doctor`, and what it says.
fn doctor(data: &Path, more: &[&str]) -> (Option<i32>, Value) {
    let data = data.to_str().unwrap();
    let arguments = [&["doctor", "--json", "--data", data], more].concat();
    let output = run(&arguments, &[]);
    let report = serde_json::from_slice(&output.stdout).unwrap();
    (output.status.code(), report)
}

fn level<'a>(report: &'a Value, check: &str) -> &'a str {
    let findings = report["findings"].as_array().unwrap();
    let found = findings.iter().find(|finding| finding["check"] == check);
    let found = found.unwrap_or_else(|| panic!("no finding about {check}: {report}"));
    found["level"].as_str().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_doctor_reads_beside_a_service() {
    let directory = TempDir::new().unwrap();
    let data = directory.path().join("data");
    let mut service = Process::start(&data);
    let client = Client::new(&service.url);
    client.put_route(ROUTE, Value::Null).await;
    let (code, report) = doctor(&data, &["--url", &service.url]);
    for check in [
        "service", "schema", "clock", "queue", "settings", "webhooks", "vehicles", "sync",
    ] {
        assert_eq!(level(&report, check), "ok", "{report}");
    }
    let worst = ["ok", "warning", "error"]
        .iter()
        .position(|l| report["level"] == *l);
    assert_eq!(code, worst.map(|worst| worst as i32));
    let url = service.url.clone();
    service.kill();

    let (code, report) = doctor(&data, &["--url", &url, "--insecure-open-to-network"]);
    assert_eq!(level(&report, "service"), "error");
    assert_eq!(level(&report, "settings"), "warning");
    assert_eq!(code, Some(2));

    let file = data.join("mapshift.db");
    let mut raw = SqliteConnectOptions::new()
        .filename(&file)
        .connect()
        .await
        .unwrap();
    sqlx::query(
        "DELETE FROM _sqlx_migrations WHERE version = (SELECT max(version) FROM _sqlx_migrations)",
    )
    .execute(&mut raw)
    .await
    .unwrap();
    drop(raw);
    assert_eq!(level(&doctor(&data, &[]).1, "schema"), "warning");
    let (code, report) = doctor(&directory.path().join("none"), &[]);
    assert_eq!((code, level(&report, "database")), (Some(2), "error"));
}
