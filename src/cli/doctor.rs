//! `mapshift doctor`.

mod database;
mod disk;
mod finding;
mod host;
mod settings;

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use jiff::Timestamp;
use serde::Serialize;

use super::key_arg::KeyArg;
use crate::client::Gateway;
use crate::config::ServiceArgs;
use crate::store::{self, SchemaAge};
use finding::{Finding, Level};

/// Arguments of `mapshift doctor`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Also check whether the service at this address is ready.
    #[arg(long)]
    url: Option<String>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    key: KeyArg,
    #[command(flatten)]
    service: ServiceArgs,
}

/// What was found.
#[derive(Serialize)]
struct Report {
    /// That of the worst finding.
    level: Level,
    findings: Vec<Finding>,
}

/// Checks an installation and prints the findings. Exit code 1 for warnings, 2 for errors. Reads only, except
/// for one file that it writes and removes to test the directory.
///
/// # Errors
/// If standard output is closed.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let findings = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?
        .block_on(examine(args));
    let worst = findings.iter().map(|finding| finding.level).max();
    let report = Report {
        level: worst.unwrap_or(Level::Ok),
        findings,
    };
    let mut out = std::io::stdout().lock();
    if args.json {
        serde_json::to_writer_pretty(&mut out, &report)?;
        writeln!(out)?;
    } else {
        for found in &report.findings {
            writeln!(
                out,
                "{:<8} {}: {}",
                found.level.word(),
                found.check,
                found.finding
            )?;
            if let Some(advice) = &found.advice {
                writeln!(out, "         → {advice}")?;
            }
        }
    }
    Ok(match report.level {
        Level::Ok => ExitCode::SUCCESS,
        Level::Warning => ExitCode::from(1),
        Level::Error => ExitCode::from(2),
    })
}

async fn examine(args: &Args) -> Vec<Finding> {
    let data = &args.service.data;
    let mut findings = settings::check(&args.service);
    if let Some(url) = &args.url {
        findings.push(service(url, args.key.key.as_deref()).await);
    }
    if data.is_dir() {
        findings.extend(host::check(data));
        findings.extend(in_database(data).await);
    } else {
        findings.push(no_database(data, "there is no such directory".to_owned()));
    }
    findings
}

async fn in_database(data: &Path) -> Vec<Finding> {
    let now = Timestamp::now();
    let contents = match store::contents(data).await {
        Ok(contents) => contents,
        Err(error) => {
            let error = format!("{:#}", anyhow::Error::from(error));
            return vec![disk::check(data, None, now), no_database(data, error)];
        }
    };
    let schema = database::schema(&contents);
    if contents.schema_age() != SchemaAge::Same {
        return vec![disk::check(data, None, now), schema];
    }
    match store::checkup(data, disk::recent(now)).await {
        Ok(checkup) => {
            let mut findings = vec![disk::check(data, Some(&checkup), now), schema];
            findings.extend(database::check(&checkup, now));
            findings
        }
        Err(error) => {
            let error = format!("{:#}", anyhow::Error::from(error));
            vec![
                disk::check(data, None, now),
                schema,
                no_database(data, error),
            ]
        }
    }
}

fn no_database(data: &Path, error: String) -> Finding {
    let finding = format!("none can be read in {}: {error}", data.display());
    let advice = "name the directory of the service (--data, or its settings file with --config), and run as its user";
    Finding::error("database", finding, advice)
}

async fn service(url: &str, key: Option<&str>) -> Finding {
    let check = "service";
    let answer = match Gateway::new(url, key, |_: &str| {}) {
        Ok(gateway) => gateway.readiness().await,
        Err(error) => Err(error),
    };
    match answer {
        Ok(None) => Finding::ok(check, format!("{url} is ready")),
        Ok(Some(why)) => Finding::error(
            check,
            format!("{url} is not ready: {why}"),
            "see the log of the service",
        ),
        Err(error) => Finding::error(
            check,
            format!("{:#}", anyhow::Error::from(error)),
            "give an address like http://127.0.0.1:8080",
        ),
    }
}
