//! Whether a database holds what it should: its checksums, and the laws that its tables keep.
//!
//! Reads only, in short snapshots, beside a service that writes.

use std::path::Path;

use serde::Serialize;
use sqlx::SqlitePool;

use super::connection::Database;
use super::error::{Corruption, StoreError};
use super::records::BatchFilter;
use super::{graph, intermediate_scans, journal, routes};
use crate::ids::RouteId;

/// Rows of one read.
const PAGE: u32 = 256;
/// Faults that are named.
const FAULTS_MAX: usize = 100;

/// Statements that find what contradicts a law; each row names one fault.
const LAWS: [(&str, &str); 10] = [
    (
        "what a row refers to is there",
        "SELECT format('row %s of %s has no %s', rowid, \"table\", parent) \
         FROM pragma_foreign_key_check",
    ),
    (
        "a batch has a job while it is queued or processing, and then alone",
        "SELECT format('job %d', job_id) FROM jobs LEFT JOIN batches USING (batch_key) \
         WHERE status IS NULL OR status NOT IN ('queued', 'processing') \
         UNION ALL SELECT format('batch %s of trip %s', id, trip_id) FROM batches \
         WHERE status IN ('queued', 'processing') \
         AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.batch_key = batches.batch_key)",
    ),
    (
        "a merged batch has as many nodes as it says",
        "SELECT format('batch %s of trip %s', id, trip_id) FROM batches \
         WHERE status = 'merged' AND nodes_added <> \
             (SELECT count(*) FROM nodes WHERE nodes.batch_key = batches.batch_key)",
    ),
    (
        "a route has as many rows as it says",
        "SELECT format('route %s', id) FROM routes WHERE (batches, nodes, edges) <> ( \
             (SELECT count(*) FROM batches AS b WHERE b.route_key = routes.route_key), \
             (SELECT count(*) FROM nodes AS n WHERE n.route_key = routes.route_key), \
             (SELECT count(*) FROM edges AS e WHERE e.route_key = routes.route_key))",
    ),
    (
        "an edge has both its ends",
        "SELECT format('edge %d of route %s', edge_id, id) FROM edges JOIN routes USING (route_key) \
         WHERE 2 <> (SELECT count(*) FROM nodes WHERE nodes.route_key = edges.route_key \
             AND node_id IN (from_node, to_node))",
    ),
    (
        "poses are finite",
        "SELECT format('node %d of route %s', node_id, id) FROM nodes JOIN routes USING (route_key) \
         WHERE NOT (abs(x) < 9e999 AND abs(y) < 9e999 AND abs(theta) < 3.1415927)",
    ),
    (
        "information is not negative",
        "SELECT format('edge %d of route %s', edge_id, id) FROM edges JOIN routes USING (route_key) \
         WHERE NOT (info_xx >= 0 AND info_yy >= 0 AND info_tt >= 0 \
             AND info_xy * info_xy <= info_xx * info_yy * (1 + 1e-9) \
             AND info_xt * info_xt <= info_xx * info_tt * (1 + 1e-9) \
             AND info_yt * info_yt <= info_yy * info_tt * (1 + 1e-9))",
    ),
    (
        "the sums over what has left count what has left",
        "SELECT format('route %s', id) FROM routes WHERE \
         (SELECT coalesce(sum(nodes), 0) FROM archive_sums AS s \
             WHERE s.route_key = routes.route_key) <> \
         (SELECT count(*) FROM nodes AS n WHERE n.route_key = routes.route_key AND n.active = 0)",
    ),
    (
        "the edges of an alert are there",
        "SELECT format('edge %s of alert %s', named.value, alerts.id) \
         FROM alerts, json_each(alerts.edges) AS named WHERE NOT EXISTS (SELECT 1 FROM edges \
             WHERE edges.route_key = alerts.route_key AND edges.edge_id = named.value)",
    ),
    (
        "a map has a picture of each version before the present one",
        "SELECT format('route %s', id) FROM routes WHERE map_version - 1 <> \
             (SELECT count(*) FROM map_versions AS v WHERE v.route_key = routes.route_key)",
    ),
];

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
/// [`StoreError`] if the database cannot be read at all.
pub async fn fsck(
    data_dir: &Path,
    full: bool,
    on_progress: OnProgress<'_>,
) -> Result<FsckReport, StoreError> {
    let readers = Database::in_directory(data_dir).open_readers().await?;
    let total: i64 =
        sqlx::query_scalar("SELECT coalesce(sum(batches + nodes + edges), 0) FROM routes")
            .fetch_one(&readers)
            .await?;
    let mut check = Check {
        readers: &readers,
        report: FsckReport::default(),
        total: u64::try_from(total).unwrap_or_default(),
        on_progress,
    };
    if full {
        check.law("the file is sound", INTEGRITY).await;
    }
    for (law, statement) in LAWS {
        check.law(law, statement).await;
    }
    check.rows().await?;
    let mut report = check.report;
    readers.close().await;
    report.sound = report.faults.is_empty();
    Ok(report)
}

const INTEGRITY: &str =
    "SELECT integrity_check FROM pragma_integrity_check WHERE integrity_check <> 'ok'";

struct Check<'a> {
    readers: &'a SqlitePool,
    report: FsckReport,
    total: u64,
    on_progress: OnProgress<'a>,
}

impl Check<'_> {
    fn fault(&mut self, law: &str, what: String) {
        if self.report.faults.len() < FAULTS_MAX {
            let law = law.to_owned();
            self.report.faults.push(Fault { law, what });
        } else {
            self.report.faults_left_off += 1;
        }
    }

    async fn law(&mut self, law: &str, statement: &'static str) {
        let faults: Result<Vec<String>, _> =
            sqlx::query_scalar(statement).fetch_all(self.readers).await;
        match faults {
            Ok(faults) => faults.into_iter().for_each(|what| self.fault(law, what)),
            Err(error) => self.fault(law, format!("it could not be checked: {error}")),
        }
    }

    async fn rows(&mut self) -> Result<(), StoreError> {
        let mut after = None;
        loop {
            let page = routes::routes(self.readers, after.as_ref(), PAGE).await?;
            for route in &page {
                self.report.routes += 1;
                self.batches(&route.id).await?;
                self.nodes(&route.id).await?;
                self.edges(&route.id).await?;
            }
            match page.last() {
                Some(last) => after = Some(last.id.clone()),
                None => return Ok(()),
            }
        }
    }

    async fn batches(&mut self, route: &RouteId) -> Result<(), StoreError> {
        let mut after = None;
        loop {
            let filter = BatchFilter::default();
            let page = journal::batches(self.readers, route, &filter, after.as_ref(), PAGE).await?;
            for batch in &page {
                let entry = journal::entry(self.readers, route, &batch.id).await;
                self.note(route, entry)?;
            }
            let Some(last) = page.last() else {
                return Ok(());
            };
            after = Some(last.id.clone());
            self.report.batches += page.len() as u64;
            self.progress();
        }
    }

    async fn nodes(&mut self, route: &RouteId) -> Result<(), StoreError> {
        let (mut after, mut limit) = (None, PAGE);
        loop {
            let page = match graph::node_page(self.readers, route, after, limit).await {
                // Those before it in the page are read first, one by one.
                Err(StoreError::Corrupt(Corruption::Node(_))) if limit > 1 => {
                    limit = 1;
                    continue;
                }
                Err(StoreError::Corrupt(Corruption::Node(id))) => {
                    self.rotten(route, &Corruption::Node(id));
                    (after, limit) = (Some(id), PAGE);
                    continue;
                }
                page => page?,
            };
            for node in &page {
                let scan = graph::node_scan(self.readers, route, node.id).await;
                self.note(route, scan)?;
                let behind = intermediate_scans::check_behind(self.readers, route, node.id).await;
                self.note(route, behind)?;
            }
            let Some(last) = page.last() else {
                return Ok(());
            };
            after = Some(last.id);
            self.report.nodes += page.len() as u64;
            self.progress();
        }
    }

    async fn edges(&mut self, route: &RouteId) -> Result<(), StoreError> {
        let mut after = None;
        let filter = super::EdgeFilter::default();
        loop {
            let page = match graph::edge_page(self.readers, route, filter, after, PAGE).await {
                Err(StoreError::Corrupt(Corruption::Edge(id))) => {
                    self.rotten(route, &Corruption::Edge(id));
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

    fn note<T>(&mut self, route: &RouteId, read: Result<T, StoreError>) -> Result<(), StoreError> {
        match read {
            Err(StoreError::Corrupt(what)) => self.rotten(route, &what),
            read => drop(read?),
        }
        Ok(())
    }

    fn rotten(&mut self, route: &RouteId, what: &Corruption) {
        self.fault(
            "what is read is what was written",
            format!("{what}, route {route}"),
        );
    }

    fn progress(&self) {
        let report = &self.report;
        let done = report.batches + report.nodes + report.edges;
        (self.on_progress)(done, self.total);
    }
}
