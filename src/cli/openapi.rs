//! `mapshift openapi`.

use std::io::Write;

use crate::api;

/// Arguments of `mapshift openapi`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Prints the OpenAPI document.
///
/// # Errors
/// If it does not serialise or standard output is closed.
pub fn run(_args: Args) -> anyhow::Result<()> {
    let document = api::openapi_document()?;
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, &document)?;
    writeln!(out)?;
    Ok(())
}
