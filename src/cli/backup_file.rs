//! A backup: one file, and its digest beside it as `sha256sum` writes it.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use sha2::{Digest, Sha256};

use crate::store::{Contents, FsckReport, SchemaAge};

const PIECE_BYTES: usize = 1 << 20;
/// Most faults that an error lists.
const FAULTS_SHOWN: usize = 5;

/// Path of a backup's digest.
pub(super) fn digest_path(file: &Path) -> PathBuf {
    let mut path = file.as_os_str().to_owned();
    path.push(".sha256");
    path.into()
}

/// Copies a file to a writer and returns the SHA-256 of the copy.
pub(super) fn copy_digesting(file: &Path, mut into: impl Write) -> anyhow::Result<String> {
    let failed = || format!("cannot read {}", file.display());
    let mut source = File::open(file).with_context(failed)?;
    let mut piece = vec![0; PIECE_BYTES];
    let mut digest = Sha256::new();
    loop {
        let length = source.read(&mut piece).with_context(failed)?;
        let Some(read) = piece.get(..length).filter(|read| !read.is_empty()) else {
            break;
        };
        digest.update(read);
        into.write_all(read).context("cannot write the copy")?;
    }
    let mut text = String::new();
    for byte in digest.finalize() {
        write!(text, "{byte:02x}")?;
    }
    Ok(text)
}

/// The digest that was written beside a backup; `None` if there is none.
pub(super) fn noted_digest(file: &Path) -> anyhow::Result<Option<String>> {
    let path = digest_path(file);
    match std::fs::read_to_string(&path) {
        Ok(text) => Ok(text.split_whitespace().next().map(str::to_owned)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
    }
}

/// Fails if a check has found anything, with what it found.
pub(super) fn ensure_sound(report: &FsckReport) -> anyhow::Result<()> {
    if report.sound {
        return Ok(());
    }
    let faults = report.faults.iter().take(FAULTS_SHOWN);
    let faults: Vec<String> = faults
        .map(|fault| format!("{}: {}", fault.law, fault.what))
        .collect();
    let count = report.faults.len() as u64 + report.faults_left_off;
    bail!("{count} faults, the first of them: {}", faults.join("; "));
}

/// What is in a backup, in a sentence.
pub(super) fn describe(contents: &Contents) -> String {
    let newest = match contents.newest_batch_at {
        Some(at) => format!("the newest batch arrived at {at:.0}"),
        None => "no batch".to_owned(),
    };
    let schema = match contents.schema_age() {
        SchemaAge::Same => String::new(),
        SchemaAge::Older => " (older: the service brings it up to date when it starts)".to_owned(),
        SchemaAge::Newer => " (newer than this program)".to_owned(),
    };
    format!(
        "{} routes, {} batches, {} nodes, {} alerts; {newest}; {} commits, schema {}{schema}",
        contents.routes,
        contents.batches,
        contents.nodes,
        contents.alerts,
        contents.commits,
        contents.schema
    )
}
