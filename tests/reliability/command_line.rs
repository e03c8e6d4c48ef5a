//! What the harness is asked for: by hand, or by `cargo test`, which hands on what it was given.

use clap::Parser;

use crate::row::{Form, Row};

/// Shows row by row what the service promises when things go wrong.
#[derive(Debug, Parser)]
#[command(name = "cargo reliability", bin_name = "cargo reliability")]
pub struct CommandLine {
    /// Name the rows.
    #[arg(long)]
    pub list: bool,
    /// Run the named rows in full, or all of them; with --release for the document's figures.
    #[arg(long)]
    full: bool,
    /// Rows; without --full also parts of their names.
    names: Vec<String>,
    #[command(flatten)]
    libtest: Libtest,
}

/// What `cargo test` may hand on to every target, and this one too.
#[derive(Debug, clap::Args)]
struct Libtest {
    #[arg(long, hide = true)]
    skip: Vec<String>,
    #[arg(long, hide = true)]
    exact: bool,
    /// Only tests that are ignored, of which there are none.
    #[arg(long, hide = true)]
    ignored: bool,
    #[arg(long, hide = true)]
    include_ignored: bool,
    #[arg(long, hide = true, alias = "no-capture", alias = "show-output")]
    nocapture: bool,
    #[arg(short, long, hide = true)]
    quiet: bool,
    #[arg(long, hide = true)]
    test_threads: Option<String>,
    #[arg(long, hide = true)]
    format: Option<String>,
    #[arg(long, hide = true)]
    color: Option<String>,
    #[arg(short = 'Z', hide = true)]
    unstable: Vec<String>,
    #[arg(long, hide = true)]
    report_time: bool,
    #[arg(long, hide = true)]
    shuffle: bool,
}

impl CommandLine {
    pub fn of_process() -> Self {
        Self::parse()
    }

    pub fn form(&self) -> Form {
        match self.full {
            true => Form::Full,
            false => Form::Quick,
        }
    }

    /// The rows that are meant, or what to say instead.
    pub fn choose<'a>(&self, rows: &'a [Row]) -> Result<Vec<&'a Row>, String> {
        let known: Vec<&str> = rows.iter().map(|row| row.name).collect();
        let unknown = self
            .names
            .iter()
            .find(|name| !known.contains(&name.as_str()));
        if let (true, Some(name)) = (self.full, unknown) {
            return Err(format!(
                "there is no row {name:?}: the rows are {}, and --list says what each shows",
                known.join(", ")
            ));
        }
        let chosen: Vec<&Row> = rows.iter().filter(|row| self.takes(row)).collect();
        if chosen.is_empty() && !self.names.is_empty() {
            // A filter of `cargo test` that means other targets.
            println!(
                "no row of reliability is named {}; the rows are {}",
                self.names.join(" or "),
                known.join(", ")
            );
        }
        Ok(chosen)
    }

    fn takes(&self, row: &Row) -> bool {
        let exact = self.full || self.libtest.exact;
        let is_meant = |name: &String| match exact {
            true => row.name == name,
            false => row.name.contains(name.as_str()),
        };
        let is_named = self.names.is_empty() || self.names.iter().any(is_meant);
        is_named && !self.libtest.ignored && !self.libtest.skip.iter().any(is_meant)
    }
}
