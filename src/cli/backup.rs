//! `mapshift backup`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail};
use jiff::Timestamp;

use super::backup_file::{copy_digesting, describe, digest_path, ensure_sound};
use super::progress::{Progress, say};
use crate::store;

const WATCH_INTERVAL: Duration = Duration::from_millis(200);
const MEBIBYTE: u64 = 1 << 20;

/// Arguments of `mapshift backup`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Directory that holds the database; a service may be running on it.
    #[arg(long, env = "MAPSHIFT_DATA_DIR", default_value = "./data")]
    data: PathBuf,
    /// The file to write, or a directory in which it is named by the time. Nothing is overwritten.
    #[arg(long, value_name = "FILE|DIR")]
    output: PathBuf,
}

/// Copies a consistent snapshot of the database, checks the copy, and then renames it into place.
///
/// # Errors
/// If the file is there already, the database cannot be copied, or the copy is not sound.
pub fn run(args: &Args) -> anyhow::Result<()> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?
        .block_on(back_up(args))
}

async fn back_up(args: &Args) -> anyhow::Result<()> {
    let output = output_file(&args.output);
    for path in [&output, &digest_path(&output)] {
        if path.exists() {
            bail!(
                "{} is there already: nothing is overwritten",
                path.display()
            );
        }
    }
    let parent = match output.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // In the same file system, so that it can be renamed, and in a directory that only the owner can read.
    let scratch = tempfile::Builder::new()
        .prefix(".mapshift-backup-")
        .tempdir_in(parent)
        .with_context(|| format!("cannot make a directory in {}", parent.display()))?;
    let staged = scratch.path().join("copy");
    copy(&args.data, &staged)
        .await
        .with_context(|| format!("cannot copy the database in {}", args.data.display()))?;
    check(&staged).await?;
    let contents = store::backup_contents(&staged).await?;
    let digest = copy_digesting(&staged, std::io::sink())?;
    put(&staged, &output, parent)?;
    write_digest(&output, &digest)?;
    say(&format!("{}: {}", output.display(), describe(&contents)));
    Ok(())
}

fn output_file(output: &Path) -> PathBuf {
    match output.is_dir() {
        true => {
            let now = Timestamp::now().strftime("%Y%m%dT%H%M%SZ");
            output.join(format!("mapshift-{now}.db"))
        }
        false => output.to_path_buf(),
    }
}

/// Copies the database with a progress bar.
async fn copy(data: &Path, into: &Path) -> anyhow::Result<()> {
    let size_mib = |path: &Path| std::fs::metadata(path).map_or(0, |file| file.len() / MEBIBYTE);
    let total_mib = size_mib(&data.join("mapshift.db"));
    let progress = Progress::new(total_mib, "MiB copied");
    let copying = store::back_up(data, into);
    tokio::pin!(copying);
    loop {
        match tokio::time::timeout(WATCH_INTERVAL, &mut copying).await {
            Ok(copied) => {
                progress.finish();
                return Ok(copied?);
            }
            Err(_) => progress.advance_to(size_mib(into).min(total_mib)),
        }
    }
}

async fn check(copy: &Path) -> anyhow::Result<()> {
    let progress = std::sync::OnceLock::new();
    let on_progress = |done: u64, total: u64| {
        let bar = progress.get_or_init(|| Progress::new(total, "rows checked"));
        bar.advance_to(done);
    };
    let report = store::check_backup(copy, &on_progress).await?;
    if let Some(bar) = progress.into_inner() {
        bar.finish();
    }
    ensure_sound(&report).context(
        "the copy is not sound, and no backup was written; `mapshift fsck --full` says whether the \
         database is",
    )
}

/// Renames the copy into place unless the name is taken by now.
fn put(staged: &Path, output: &Path, parent: &Path) -> anyhow::Result<()> {
    let moved = tempfile::TempPath::try_from_path(staged)?.persist_noclobber(output);
    moved.with_context(|| format!("cannot write {}", output.display()))?;
    let parent = std::fs::File::open(parent).and_then(|directory| directory.sync_all());
    parent.with_context(|| format!("cannot write {} to the disk", output.display()))
}

fn write_digest(output: &Path, digest: &str) -> anyhow::Result<()> {
    let path = digest_path(output);
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    let failed = || format!("cannot write {}", path.display());
    let mut file = std::fs::File::create_new(&path).with_context(failed)?;
    writeln!(file, "{digest}  {name}").with_context(failed)?;
    file.sync_all().with_context(failed)
}
