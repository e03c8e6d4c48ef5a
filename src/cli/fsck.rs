//! `mapshift fsck`.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;

use super::progress::Progress;
use crate::store;

/// Arguments of `mapshift fsck`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Directory that holds the database; a service may be running on it.
    #[arg(long, env = "MAPSHIFT_DATA_DIR", default_value = "./data")]
    data: PathBuf,
    /// Let SQLite check the whole file as well. That is one long read, in which the write-ahead log
    /// of a running service cannot be cut back.
    #[arg(long)]
    full: bool,
}

/// Prints what is wrong as JSON; fails if anything is.
///
/// # Errors
/// If the database cannot be read at all.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let progress = std::sync::OnceLock::new();
    let on_progress = |done: u64, total: u64| {
        let bar = progress.get_or_init(|| Progress::at_a_terminal(total, "rows"));
        bar.advance_to(done);
    };
    let report = runtime
        .block_on(store::fsck(&args.data, args.full, &on_progress))
        .with_context(|| format!("cannot read the database in {}", args.data.display()))?;
    if let Some(bar) = progress.into_inner() {
        bar.finish();
    }
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, &report)?;
    writeln!(out)?;
    Ok(match report.sound {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}
