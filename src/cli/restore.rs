//! `mapshift restore`.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use jiff::Timestamp;

use super::backup_file::{copy_digesting, describe, digest_path, ensure_sound, noted_digest};
use super::progress::{Progress, say};
use crate::store::{self, HeldDirectory, SchemaAge};

/// Arguments of `mapshift restore`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The backup.
    file: PathBuf,
    /// Directory to restore into, for `mapshift serve --data`; created if missing.
    #[arg(long, env = "MAPSHIFT_DATA_DIR", default_value = "./data")]
    data: PathBuf,
    /// Replace an existing database, whose files are kept in a directory beside it.
    #[arg(long)]
    replace: bool,
}

/// Checks a backup and restores it into a data directory on which no service runs. Files restored by root
/// belong to the owner of the directory.
///
/// # Errors
/// If the backup is not sound or too new, or the directory is in use or has a database.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let digest = noted_digest(&args.file)?;
    match &digest {
        Some(noted) if *noted != copy_digesting(&args.file, std::io::sink())? => bail!(
            "{} is not what was written: its SHA-256 is not that of {}",
            args.file.display(),
            digest_path(&args.file).display()
        ),
        Some(_) => {}
        None => say("there is no .sha256 beside the file: its digest is not compared"),
    }
    runtime
        .block_on(check(&args.file))
        .with_context(|| format!("{} cannot be restored", args.file.display()))?;
    put(args, digest.as_deref())?;
    say("Gateways must send again what was acknowledged after the backup was made.");
    Ok(())
}

/// Checks a backup and prints its contents.
async fn check(file: &Path) -> anyhow::Result<()> {
    let contents = store::backup_contents(file).await;
    let contents = contents.context("it is not a database of this service")?;
    if contents.schema_age() == SchemaAge::Newer {
        bail!(
            "its schema {} is newer than this program, which would not understand it: restore it \
             with the version that made it",
            contents.schema
        );
    }
    let progress = std::sync::OnceLock::new();
    let on_progress = |done: u64, total: u64| {
        let bar = progress.get_or_init(|| Progress::new(total, "rows checked"));
        bar.advance_to(done);
    };
    let report = store::check_backup(file, &on_progress).await?;
    if let Some(bar) = progress.into_inner() {
        bar.finish();
    }
    ensure_sound(&report)?;
    say(&format!("{}: {}", file.display(), describe(&contents)));
    Ok(())
}

fn put(args: &Args, digest: Option<&str>) -> anyhow::Result<()> {
    let data = &args.data;
    let held = HeldDirectory::hold(data)?;
    let earlier = held.database_files();
    if let (Some(file), false) = (earlier.first(), args.replace) {
        bail!(
            "{} is there already; --replace keeps what is there in a directory beside it",
            file.display()
        );
    }
    let scratch = tempfile::Builder::new()
        .prefix(".mapshift-restore-")
        .tempdir_in(data)
        .with_context(|| format!("cannot make a directory in {}", data.display()))?;
    let staged = scratch.path().join("copy");
    let written = write(&args.file, &staged)?;
    if digest.is_some_and(|noted| noted != written) {
        bail!("{} changed while it was read", args.file.display());
    }
    let now = Timestamp::now().strftime("%Y%m%dT%H%M%SZ");
    let aside = data.join(format!("replaced-{now}"));
    if aside.exists() {
        bail!(
            "{} is there already: try again in a second",
            aside.display()
        );
    }
    held.put(&staged, &aside)?;
    if !earlier.is_empty() {
        say(&format!("what was there is in {}", aside.display()));
    }
    say(&format!("restored into {}", data.display()));
    Ok(())
}

/// Copies a file to one that only its owner can read and syncs it; returns its SHA-256.
fn write(file: &Path, into: &Path) -> anyhow::Result<String> {
    let failed = || format!("cannot write {}", into.display());
    let mut options = OpenOptions::new();
    let options = options.write(true).create_new(true).mode(0o600);
    let copy: File = options.open(into).with_context(failed)?;
    let digest = copy_digesting(file, &copy)?;
    copy.sync_all().with_context(failed)?;
    Ok(digest)
}
