//! `mapshift replay`.

mod report;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::OnceLock;

use anyhow::{Context, bail};

use super::progress::Progress;
use crate::ids::RouteId;
use crate::pipeline::{PipelineOptions, drawn_map, replay};
use crate::render::differing_cells;
use crate::store::{self, Store, StoreOptions};
use report::Report;

/// Arguments of `mapshift replay`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Directory that holds the database; a service may be running on it.
    #[arg(long, env = "MAPSHIFT_DATA_DIR", default_value = "./data")]
    data: PathBuf,
    /// Only this route; may be given several times. All routes without it.
    #[arg(long = "route", value_name = "ROUTE")]
    routes: Vec<String>,
    /// Keep the copy with the rebuilt maps in this directory, which must not contain a database yet:
    /// `mapshift serve --data` runs on it.
    #[arg(long, value_name = "DIRECTORY")]
    into: Option<PathBuf>,
    /// Report how the rebuilt maps differ from the stored ones, and fail if they do.
    #[arg(long, required_unless_present = "into")]
    compare: bool,
}

const BEGINS_LATE: &str = "its journal begins after its first batches, which an earlier version processed: it is left as it is";

/// Rebuilds maps from their journal of inputs, in a copy of the database, and prints a report as JSON, with a summary on standard error. Fails if a map cannot be rebuilt or, if compared, differs.
///
/// # Errors
/// If the database cannot be copied or read.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let reports = runtime.block_on(replay_all(args))?;
    let mut err = std::io::stderr().lock();
    for report in &reports {
        // Standard error may be closed.
        let _ = report.write_summary(&mut err);
    }
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, &reports)?;
    writeln!(out)?;
    Ok(match reports.iter().all(Report::is_good) {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}

async fn replay_all(args: &Args) -> anyhow::Result<Vec<Report>> {
    let scratch = match &args.into {
        Some(into) => Scratch::beside(into)?,
        None => Scratch::within(&args.data)?,
    };
    let copied = store::copy(&args.data, &scratch.now).await;
    copied.with_context(|| format!("cannot copy the database in {}", args.data.display()))?;
    let mut store = open(&scratch.now).await?;
    if args.compare {
        // After its schema was brought up to date, so that both have the same columns.
        store.close().await?;
        store::copy(&scratch.now, &scratch.before).await?;
        store = open(&scratch.now).await?;
    }
    let mut reports = Vec::new();
    for route in chosen(&store, &args.routes).await? {
        reports.push(replay_one(&store, route, args.compare).await?);
    }
    store.close().await?;
    for report in reports.iter_mut().filter(|_| args.compare) {
        let found = store::compare(&scratch.now, &scratch.before, &report.route).await;
        report.comparison = Some(found?);
    }
    if let Some(into) = &args.into {
        scratch.keep_as(into)?;
    }
    Ok(reports)
}

async fn open(directory: &Path) -> anyhow::Result<Store> {
    let data_dir = directory.to_path_buf();
    let opened = Store::open(StoreOptions { data_dir }).await;
    opened.context("cannot open the copy of the database")
}

/// The routes that are meant, by id.
async fn chosen(store: &Store, named: &[String]) -> anyhow::Result<Vec<RouteId>> {
    const PAGE: u32 = 256;
    let mut chosen = Vec::new();
    for name in named {
        let route = RouteId::new(name.as_str())?;
        if store.route(&route).await?.is_none() {
            bail!("there is no route {route}");
        }
        chosen.push(route);
    }
    if !named.is_empty() {
        return Ok(chosen);
    }
    loop {
        let page = store.routes(chosen.last(), PAGE).await?;
        if page.is_empty() {
            return Ok(chosen);
        }
        chosen.extend(page.into_iter().map(|route| route.id));
    }
}

async fn replay_one(store: &Store, route: RouteId, compare: bool) -> anyhow::Result<Report> {
    let before = match compare {
        true => drawn_map(store, &route).await?,
        false => None,
    };
    let progress = OnceLock::new();
    let on_progress = |done: u64, total: u64| {
        let bar = progress.get_or_init(|| Progress::at_a_terminal(total, "inputs"));
        bar.advance_to(done);
    };
    let replayed = replay(store, &route, PipelineOptions::default(), &on_progress).await;
    if let Some(bar) = progress.into_inner() {
        bar.finish();
    }
    let replayed = replayed?;
    let error = match replayed {
        Some(_) => None,
        None => Some(BEGINS_LATE),
    };
    let now = match before {
        Some(_) => drawn_map(store, &route).await?,
        None => None,
    };
    Ok(Report {
        route,
        replayed,
        error,
        comparison: None,
        cells: before
            .zip(now)
            .map(|(before, now)| differing_cells(&before, &now)),
    })
}

/// Where maps are rebuilt; removed in the end.
struct Scratch {
    directory: tempfile::TempDir,
    now: PathBuf,
    before: PathBuf,
}

impl Scratch {
    /// On the disk to which the copy will be moved.
    fn beside(into: &Path) -> anyhow::Result<Self> {
        let parent = match into.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        std::fs::create_dir_all(parent)
            .with_context(|| format!("cannot make {}", parent.display()))?;
        Self::within(parent)
    }

    fn within(parent: &Path) -> anyhow::Result<Self> {
        let directory = tempfile::Builder::new()
            .prefix("mapshift-replay-")
            .tempdir_in(parent)
            .with_context(|| format!("cannot make a directory in {}", parent.display()))?;
        Ok(Self {
            now: directory.path().join("now"),
            before: directory.path().join("before"),
            directory,
        })
    }

    /// Moves the copy to where it is wanted.
    fn keep_as(self, into: &Path) -> anyhow::Result<()> {
        // An empty directory gives way.
        let _ = std::fs::remove_dir(into);
        if into.exists() {
            bail!("{} is there already, and not empty", into.display());
        }
        std::fs::rename(&self.now, into)
            .with_context(|| format!("cannot move the copy to {}", into.display()))?;
        Ok(self.directory.close()?)
    }
}
