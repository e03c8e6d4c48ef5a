//! Pose graphs on disk.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use anyhow::Context;
use flate2::read::MultiGzDecoder;

use crate::ingest::g2o::{G2oGraph, read_g2o};

const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// So much of a file's beginning tells whether it is a graph, bytes.
const BEGINNING_BYTES: u64 = 1 << 16;

/// Reads a planar graph as g2o text, gzipped or not.
///
/// # Errors
/// If the file cannot be read, or is none.
pub(super) fn read_graph(path: &Path) -> anyhow::Result<G2oGraph> {
    let name = path.display();
    let text = read_text(path).with_context(|| format!("cannot read {name}"))?;
    read_g2o(&text).with_context(|| format!("{name} is not a planar g2o graph"))
}

/// Whether a file begins as a graph does, whatever its name is.
///
/// # Errors
/// If the file cannot be read.
pub(super) fn is_graph(path: &Path) -> std::io::Result<bool> {
    let mut beginning = Vec::new();
    // A file that cannot be unpacked is no graph, and its own reader says what is wrong with it.
    let _ = unpacked(path)?
        .take(BEGINNING_BYTES)
        .read_to_end(&mut beginning);
    let text = String::from_utf8_lossy(&beginning);
    let mut words = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .filter_map(|line| line.split_ascii_whitespace().next());
    let tags = ["VERTEX", "EDGE_SE", "FIX"];
    Ok(words
        .next()
        .is_some_and(|word| tags.iter().any(|tag| word.starts_with(tag))))
}

fn read_text(path: &Path) -> anyhow::Result<String> {
    let mut bytes = Vec::new();
    let read = unpacked(path)?.read_to_end(&mut bytes);
    read.context("it is gzipped, but damaged")?;
    String::from_utf8(bytes).context("it is neither text nor gzipped text")
}

fn unpacked(path: &Path) -> std::io::Result<Box<dyn Read>> {
    let mut file = BufReader::new(File::open(path)?);
    Ok(if file.fill_buf()?.starts_with(&GZIP_MAGIC) {
        Box::new(MultiGzDecoder::new(file))
    } else {
        Box::new(file)
    })
}
