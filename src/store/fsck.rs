//! Whether a database holds what it should: its checksums, and the laws that its tables keep.
//!
//! Reads only, one statement after the other, beside a service that writes.

use std::fmt::Display;
use std::path::Path;

use serde::Serialize;
use sqlx::{Connection, SqliteConnection};

use super::acceptances::{AcceptanceOf, AcceptedChanges};
use super::alert_records::MapVersionRecord;
use super::connection::Database;
use super::edges::EdgePage;
use super::error::{Corruption, StoreError};
use super::intermediate_scans::CheckBehind;
use super::journal::{BatchPage, OneEntry};
use super::laws::{FILE_IS_SOUND, LAWS, Law, for_each_fault};
use super::map_versions::{VersionPage, VersionPicture};
use super::marker;
use super::nodes::{NodePage, NodeScan};
use super::query::Query;
use super::records::{BatchFilter, BatchRecord, EdgeFilter};
use super::routes::RoutePage;
use crate::ids::RouteId;

/// Rows of one read.
const PAGE: u32 = 256;
/// Faults that are named.
const FAULTS_MAX: usize = 100;

/// What was found in a database.
#[derive(Debug, Default, Serialize)]
pub struct FsckReport {
    /// Whether nothing is wrong.
    pub sound: bool,
    /// Routes whose rows were read.
    pub routes: u64,
    /// Uploads whose bodies were read.
    pub batches: u64,
    /// Nodes that were read, with their scans and those behind them.
    pub nodes: u64,
    /// Edges that were read.
    pub edges: u64,
    /// What is wrong.
    pub faults: Vec<Fault>,
    /// Faults beyond those named.
    pub faults_left_off: u64,
}

impl FsckReport {
    fn add(&mut self, law: &str, what: String) {
        if self.faults.len() < FAULTS_MAX {
            let law = law.to_owned();
            self.faults.push(Fault { law, what });
        } else {
            self.faults_left_off += 1;
        }
    }
}

/// Something that is wrong.
#[derive(Debug, Serialize, PartialEq, Eq)]
pub struct Fault {
    /// What does not hold.
    pub law: String,
    /// Where it does not.
    pub what: String,
}

/// How far the check has come: the rows that it has read, and all that there are.
pub type OnProgress<'a> = &'a (dyn Fn(u64, u64) + Sync);

/// Checks the database of a data directory; `full` has SQLite check its file as well, in one long
/// read. A service may hold the directory.
///
/// # Errors
/// [`StoreError`] if the database cannot be read at all, or has the schema of an older version.
pub async fn fsck(
    data_dir: &Path,
    full: bool,
    on_progress: OnProgress<'_>,
) -> Result<FsckReport, StoreError> {
    // Before the database is read: a service may commit meanwhile.
    let commits = marker::commits_before(data_dir);
    check(
        &Database::in_directory(data_dir),
        commits,
        full,
        on_progress,
    )
    .await
}

/// Checks a backup and its file as [`fsck`] does; of one with another schema the file alone.
///
/// # Errors
/// [`StoreError`] if it cannot be read at all.
pub async fn check_backup(
    file: &Path,
    on_progress: OnProgress<'_>,
) -> Result<FsckReport, StoreError> {
    let database = Database::at(file);
    match check(&database, None, true, on_progress).await {
        Err(StoreError::OldSchema) => check_file(&database).await,
        checked => checked,
    }
}

async fn check(
    database: &Database,
    commits: Option<i64>,
    full: bool,
    on_progress: OnProgress<'_>,
) -> Result<FsckReport, StoreError> {
    let mut reader = database.open_reader().await?;
    if !database.is_up_to_date(&mut reader).await? {
        reader.close().await?;
        return Err(StoreError::OldSchema);
    }
    let mut check = Check::of(reader, on_progress);
    check.total = check.read(TotalRows).await?;
    check.commits(commits).await?;
    if full {
        check.law(FILE_IS_SOUND).await?;
    }
    for law in LAWS {
        check.law(law).await?;
    }
    let rows = check.rows().await;
    check.note("the routes", rows)?;
    check.end().await
}

/// Checks what does not depend on the schema.
async fn check_file(database: &Database) -> Result<FsckReport, StoreError> {
    let mut check = Check::of(database.open_reader().await?, &|_, _| {});
    check.law(FILE_IS_SOUND).await?;
    check.end().await
}

/// How many rows the check reads.
struct TotalRows;

impl Query for TotalRows {
    type Answer = u64;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let total: i64 =
            sqlx::query_scalar("SELECT coalesce(sum(batches + nodes + edges), 0) FROM routes")
                .fetch_one(reader)
                .await?;
        Ok(u64::try_from(total).unwrap_or_default())
    }
}

struct Check<'a> {
    reader: SqliteConnection,
    report: FsckReport,
    total: u64,
    on_progress: OnProgress<'a>,
}

impl<'a> Check<'a> {
    fn of(reader: SqliteConnection, on_progress: OnProgress<'a>) -> Self {
        Self {
            reader,
            report: FsckReport::default(),
            total: 0,
            on_progress,
        }
    }

    async fn end(self) -> Result<FsckReport, StoreError> {
        let mut report = self.report;
        report.sound = report.faults.is_empty();
        self.reader.close().await?;
        Ok(report)
    }

    async fn read<Q: Query>(&mut self, query: Q) -> Result<Q::Answer, StoreError> {
        query.answer(&mut self.reader).await
    }

    /// Notes a read that found something corrupt.
    ///
    /// # Errors
    /// Whatever else it failed with.
    fn note<T>(
        &mut self,
        place: impl Display,
        read: Result<T, StoreError>,
    ) -> Result<(), StoreError> {
        match read.map_err(StoreError::named) {
            Err(StoreError::Corrupt(what)) => self.corrupt(place, &what),
            read => drop(read?),
        }
        Ok(())
    }

    fn corrupt(&mut self, place: impl Display, what: &Corruption) {
        let what = match what {
            Corruption::Body { .. } | Corruption::Scan { .. } => what.to_string(),
            Corruption::Node(_) | Corruption::Edge(_) => format!("{what} of {place}"),
            _ => format!("{place}: {what}"),
        };
        self.report.add("what is read is what was written", what);
    }

    async fn commits(&mut self, noted: Option<i64>) -> Result<(), StoreError> {
        let there = marker::commits(&mut self.reader).await?;
        if let Some(lost) = noted.map(|noted| noted - there).filter(|lost| *lost > 0) {
            self.report.add(
                "every commit is there",
                format!("the last {lost}: the write-ahead log is missing or not whole"),
            );
        }
        Ok(())
    }

    async fn law(&mut self, law: Law) -> Result<(), StoreError> {
        let Self { reader, report, .. } = self;
        let read = for_each_fault(reader, law, |what| report.add(law.0, what)).await;
        self.note(law.0, read)
    }

    async fn rows(&mut self) -> Result<(), StoreError> {
        let mut after = None;
        loop {
            let page = RoutePage {
                among: None,
                after: after.as_ref(),
                limit: PAGE,
            };
            let page = self.read(page).await?;
            for route in &page {
                self.report.routes += 1;
                let place = format!("route {}", route.id);
                for read in [
                    self.batches(&route.id, &place).await,
                    self.nodes(&route.id, &place).await,
                    self.edges(&route.id, &place).await,
                    self.versions(&route.id, &place).await,
                ] {
                    self.note(&place, read)?;
                }
            }
            match page.last() {
                Some(last) => after = Some(last.id.clone()),
                None => return Ok(()),
            }
        }
    }

    async fn batches(&mut self, route: &RouteId, place: &str) -> Result<(), StoreError> {
        let mut after = None;
        let filter = BatchFilter::default();
        loop {
            let page = BatchPage {
                route,
                filter: &filter,
                after: after.as_ref(),
                limit: PAGE,
            };
            let page = self.read(page).await?;
            for BatchRecord { id, .. } in &page {
                let entry = match self.read(OneEntry { route, id }).await {
                    Ok(Some(sealed)) => sealed.open().await.map(drop),
                    Ok(None) => Ok(()),
                    Err(error) => Err(error),
                };
                self.note(place, entry)?;
            }
            let Some(last) = page.last() else {
                return Ok(());
            };
            after = Some(last.id.clone());
            self.report.batches += page.len() as u64;
            self.progress();
        }
    }

    async fn nodes(&mut self, route: &RouteId, place: &str) -> Result<(), StoreError> {
        let (mut after, mut limit) = (None, PAGE);
        loop {
            let page = match self
                .read(NodePage {
                    route,
                    after,
                    limit,
                })
                .await
            {
                // Those before it in the page are read first, one by one.
                Err(StoreError::Corrupt(Corruption::Node(_))) if limit > 1 => {
                    limit = 1;
                    continue;
                }
                Err(StoreError::Corrupt(Corruption::Node(id))) => {
                    self.corrupt(place, &Corruption::Node(id));
                    (after, limit) = (Some(id), PAGE);
                    continue;
                }
                page => page?,
            };
            for node in &page {
                let scan = NodeScan { route, id: node.id };
                let scan = self.read(scan).await;
                self.note(place, scan)?;
                let node = node.id;
                let behind = self.read(CheckBehind { route, node }).await;
                self.note(place, behind)?;
            }
            let Some(last) = page.last() else {
                return Ok(());
            };
            after = Some(last.id);
            self.report.nodes += page.len() as u64;
            self.progress();
        }
    }

    async fn edges(&mut self, route: &RouteId, place: &str) -> Result<(), StoreError> {
        let mut after = None;
        loop {
            let page = EdgePage {
                route,
                filter: EdgeFilter::default(),
                after,
                limit: PAGE,
            };
            let page = match self.read(page).await {
                Err(StoreError::Corrupt(Corruption::Edge(id))) => {
                    self.corrupt(place, &Corruption::Edge(id));
                    after = Some(id);
                    continue;
                }
                page => page?,
            };
            let Some(last) = page.last() else {
                return Ok(());
            };
            after = Some(last.id);
            self.report.edges += page.len() as u64;
            self.progress();
        }
    }

    /// The pictures of a map's earlier versions, and what takes accepted changes back.
    async fn versions(&mut self, route: &RouteId, place: &str) -> Result<(), StoreError> {
        let mut after = 0;
        loop {
            let page = VersionPage {
                route,
                after,
                limit: PAGE,
            };
            let page = self.read(page).await?;
            for &MapVersionRecord { version, .. } in &page {
                let picture = self.read(VersionPicture { route, version }).await;
                self.note(format!("{place}, version {version}"), picture)?;
            }
            match page.last() {
                Some(last) => after = last.version,
                None => break,
            }
        }
        for change in self.read(AcceptedChanges(route)).await? {
            let undo = self.read(AcceptanceOf(change.alert_id)).await;
            self.note(format!("{place}, accepted alert {}", change.alert_id), undo)?;
        }
        Ok(())
    }

    fn progress(&self) {
        let report = &self.report;
        let done = report.batches + report.nodes + report.edges;
        (self.on_progress)(done, self.total);
    }
}
