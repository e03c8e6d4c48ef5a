//! What differs between two databases of which one is a copy of the other.
//!
//! The only statements that are composed: two files are compared by SQLite itself, which attaches the
//! one to the other, over whatever columns their tables have.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use sqlx::{AssertSqlSafe, Row, SqliteConnection};

use super::connection::Database;
use super::error::StoreError;
use crate::geometry::wrap_angle;
use crate::ids::RouteId;

/// Alerts that are named.
const ALERTS_MAX: usize = 100;

/// The tables that a route's map is kept in, each with the columns that are left out: they do not
/// belong to the map, or are numbered as rows are written.
const TABLES: [(&str, &[&str]); 14] = [
    ("nodes", &[]),
    ("edges", &[]),
    ("node_scans", &[]),
    ("intermediate_scans", &[]),
    ("closures", &[]),
    ("archive_sums", &[]),
    ("lidar_calibrations", &[]),
    ("clock_faults", &[]),
    ("vehicle_quarantines", &[]),
    // Earlier programs did not measure it.
    ("map_versions", &["max_displacement_m"]),
    ("trips", &["next_sequence"]),
    ("batches", &["held_since_us"]),
    ("alerts", &["alert_key"]),
    (
        "routes",
        &["revision", "updated_at_us", "version_max_displacement_m"],
    ),
];

/// Tables of rows that belong to an alert.
const OF_ALERTS: [&str; 2] = ["alert_history", "accepted_changes"];

/// How a route's map differs from what it was.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Whether it is the same to the bit.
    pub same: bool,
    /// The tables with rows that differ.
    pub tables: BTreeMap<&'static str, RowsApart>,
    /// How far the nodes lie apart that are in both.
    pub poses: PosesApart,
    /// How many alerts are in one only, or differ.
    pub alert_counts: AlertCounts,
    /// Those alerts; the first 100.
    pub alerts: Vec<AlertApart>,
}

/// Alerts that differ.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct AlertCounts {
    /// That were there and are not any more.
    pub only_before: usize,
    /// That were not there.
    pub only_now: usize,
    /// That are in both, and differ.
    pub changed: usize,
}

impl AlertCounts {
    fn of(alerts: &[AlertApart]) -> Self {
        let count = |there| alerts.iter().filter(|alert| alert.there == there).count();
        Self {
            only_before: count(There::OnlyBefore),
            only_now: count(There::OnlyNow),
            changed: count(There::Changed),
        }
    }
}

/// Rows that differ: a changed row counts in both.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RowsApart {
    /// Rows as they were and are not any more.
    pub only_before: u64,
    /// Rows as they were not.
    pub only_now: u64,
}

/// How far apart poses are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct PosesApart {
    /// Nodes in both.
    pub nodes: u64,
    /// Those of them that moved at all.
    pub moved: u64,
    /// The median distance, metres.
    pub median_m: f64,
    /// The largest distance, metres.
    pub max_m: f64,
    /// The largest turn, radians.
    pub max_rad: f64,
}

/// An alert that differs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlertApart {
    /// Its id.
    pub id: String,
    /// Where it is.
    pub there: There,
    /// Its kind.
    pub kind: String,
    /// Its status.
    pub status: String,
    /// Its centre in the map frame, metres.
    pub x: f64,
    /// Its centre in the map frame, metres.
    pub y: f64,
}

/// In which of two databases something is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum There {
    /// In the earlier one only.
    OnlyBefore,
    /// In the later one only.
    OnlyNow,
    /// In both, but not the same.
    Changed,
}

/// Compares a route in the database of a directory with what it was in another, of which that is a
/// copy.
///
/// # Errors
/// [`StoreError`].
pub async fn compare(
    data_dir: &Path,
    before_dir: &Path,
    route: &RouteId,
) -> Result<Comparison, StoreError> {
    let mut reader = Database::in_directory(data_dir).open_reader().await?;
    let before = Database::in_directory(before_dir);
    sqlx::query("ATTACH $1 AS before")
        .bind(before.path_text())
        .execute(&mut reader)
        .await?;
    let route_key: i64 = sqlx::query_scalar("SELECT route_key FROM routes WHERE id = $1")
        .bind(route.as_str())
        .fetch_one(&mut reader)
        .await?;
    let mut tables = BTreeMap::new();
    for (table, left_out) in TABLES {
        let columns = columns(&mut reader, table, left_out).await?;
        let rows = |schema: &str| {
            format!("SELECT {columns} FROM {schema}.{table} WHERE route_key = {route_key}")
        };
        tables.insert(table, apart(&mut reader, rows).await?);
    }
    for table in OF_ALERTS {
        let columns = columns(&mut reader, table, &["alert_key", "route_key", "id"]).await?;
        let rows = |schema: &str| {
            format!(
                "SELECT id AS alert_id, {columns} FROM {schema}.{table} AS own \
                 JOIN (SELECT alert_key AS key, id FROM {schema}.alerts \
                     WHERE route_key = {route_key}) ON key = own.alert_key"
            )
        };
        tables.insert(table, apart(&mut reader, rows).await?);
    }
    tables.retain(|_, apart| *apart != RowsApart::default());
    let mut alerts = alerts(&mut reader, route_key).await?;
    let alert_counts = AlertCounts::of(&alerts);
    alerts.truncate(ALERTS_MAX);
    Ok(Comparison {
        same: tables.is_empty(),
        tables,
        poses: poses(&mut reader, route_key).await?,
        alert_counts,
        alerts,
    })
}

/// The columns of a table but for some.
async fn columns(
    reader: &mut SqliteConnection,
    table: &str,
    left_out: &[&str],
) -> Result<String, StoreError> {
    let columns: Vec<String> = sqlx::query_scalar("SELECT name FROM pragma_table_info($1)")
        .bind(table)
        .fetch_all(reader)
        .await?;
    let columns = columns.into_iter();
    let columns = columns.filter(|column| !left_out.contains(&column.as_str()));
    Ok(columns.collect::<Vec<_>>().join(", "))
}

/// Counts the rows of a selection that one of the two databases has alone.
async fn apart(
    reader: &mut SqliteConnection,
    rows: impl Fn(&str) -> String,
) -> Result<RowsApart, StoreError> {
    let (now, before) = (rows("main"), rows("before"));
    let statement = format!(
        "SELECT (SELECT count(*) FROM ({before} EXCEPT {now})), \
         (SELECT count(*) FROM ({now} EXCEPT {before}))"
    );
    // Made of names of the schema and of a number.
    let (only_before, only_now): (i64, i64) = sqlx::query_as(AssertSqlSafe(statement))
        .fetch_one(reader)
        .await?;
    Ok(RowsApart {
        only_before: only_before.unsigned_abs(),
        only_now: only_now.unsigned_abs(),
    })
}

async fn poses(reader: &mut SqliteConnection, route_key: i64) -> Result<PosesApart, StoreError> {
    let rows: Vec<(f64, f64, f64)> = sqlx::query_as(
        "SELECT now.x - was.x, now.y - was.y, now.theta - was.theta FROM main.nodes AS now \
         JOIN before.nodes AS was USING (route_key, batch_key, stamp_ns) WHERE route_key = $1",
    )
    .bind(route_key)
    .fetch_all(reader)
    .await?;
    let distances = rows.iter().map(|(x, y, _)| x.hypot(*y));
    let mut distances_m: Vec<f64> = distances.collect();
    distances_m.sort_unstable_by(f64::total_cmp);
    let turns = rows.iter().map(|(_, _, theta)| wrap_angle(*theta).abs());
    let moved = rows.iter().filter(|apart| **apart != (0.0, 0.0, 0.0));
    Ok(PosesApart {
        nodes: rows.len() as u64,
        moved: moved.count() as u64,
        median_m: distances_m
            .get(distances_m.len() / 2)
            .copied()
            .unwrap_or_default(),
        max_m: distances_m.last().copied().unwrap_or_default(),
        max_rad: turns.fold(0.0, f64::max),
    })
}

async fn alerts(
    reader: &mut SqliteConnection,
    route_key: i64,
) -> Result<Vec<AlertApart>, StoreError> {
    let columns = columns(reader, "alerts", &["alert_key"]).await?;
    let all =
        |schema| format!("SELECT {columns} FROM {schema}.alerts WHERE route_key = {route_key}");
    let (now, before) = (all("main"), all("before"));
    let statement = format!(
        "SELECT *, TRUE AS is_now FROM ({now} EXCEPT {before}) \
         UNION ALL SELECT *, FALSE FROM ({before} EXCEPT {now}) ORDER BY id, is_now"
    );
    let rows = sqlx::query(AssertSqlSafe(statement))
        .fetch_all(reader)
        .await?;
    let mut apart: Vec<AlertApart> = Vec::new();
    for row in &rows {
        let id: String = row.try_get("id")?;
        let there = match row.try_get("is_now")? {
            true => There::OnlyNow,
            false => There::OnlyBefore,
        };
        let there = match apart.pop_if(|last| last.id == id) {
            Some(_) => There::Changed,
            None => there,
        };
        apart.push(AlertApart {
            id,
            there,
            kind: row.try_get("kind")?,
            status: row.try_get("status")?,
            x: row.try_get("x")?,
            y: row.try_get("y")?,
        });
    }
    Ok(apart)
}
