//! The columns of an alert, its history and its handling: the record that a row makes.

use jiff::Timestamp;
use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::alert_records::{AlertRecord, AlertResidual, Handling, HistoryEntry, Muted};
use super::columns::{alert_id, corrupt, json, name, optional_json, polygon, text, time, value_of};
use super::error::StoreError;
use super::handling::NO_END_US;
use crate::change::{Counterpart, Finding};
use crate::geometry::Vector2;
use crate::ids::{EdgeId, StampNs};
use crate::model::{Clearance, DismissReason};
use crate::scan::HeightBand;

/// The alert of a row.
pub(super) fn alert_of(row: &SqliteRow) -> Result<AlertRecord, StoreError> {
    Ok(AlertRecord {
        id: alert_id(row, "id")?,
        route_id: name(row, "route_id")?,
        revision: row.try_get("revision")?,
        decision_revision: row.try_get("decision_revision")?,
        decision_region: polygon(row, "decision_region")?,
        status: text(row, "status")?,
        evidence: evidence_of(row)?,
        first_seen: StampNs(row.try_get("first_seen_ns")?),
        vehicles: json(row, "vehicles")?,
        passes: optional_json(row, "passes")?,
        clearance: clearance_of(row)?,
        residual: residual_of(row)?,
        map_version: row.try_get("map_version")?,
        related: json(row, "related")?,
        raised_at: time(row, "raised_at_us")?,
        updated_at: time(row, "updated_at_us")?,
        history: history_of(row)?,
        handling: handling_of(row)?,
    })
}

fn evidence_of(row: &SqliteRow) -> Result<Finding, StoreError> {
    let count = |column| -> Result<usize, StoreError> {
        let count: i64 = row.try_get(column)?;
        usize::try_from(count).map_err(|_| corrupt(column))
    };
    let until: Option<i64> = row.try_get("until_ns")?;
    Ok(Finding {
        tier: text(row, "tier")?,
        counterpart: counterpart_of(row)?,
        shift: shift_of(row)?,
        bands: bands_of(row)?,
        suspect: optional_json(row, "suspect")?,
        kind: text(row, "kind")?,
        location: Vector2::new(row.try_get("x")?, row.try_get("y")?),
        sigma_m: row.try_get("sigma_m")?,
        region: polygon(row, "region")?,
        edges: json(row, "edges")?,
        nodes: json(row, "nodes")?,
        trips: json(row, "trips")?,
        views: count("views")?,
        laps: count("laps")?,
        confidence: row.try_get("confidence")?,
        since: StampNs(row.try_get("since_ns")?),
        last_seen: StampNs(row.try_get("last_seen_ns")?),
        until: until.map(StampNs),
    })
}

fn counterpart_of(row: &SqliteRow) -> Result<Option<Counterpart>, StoreError> {
    let kind: Option<&str> = row.try_get("counterpart_kind")?;
    if kind.is_none() {
        return Ok(None);
    }
    Ok(Some(Counterpart {
        kind: text(row, "counterpart_kind")?,
        region: polygon(row, "counterpart_region")?,
    }))
}

fn clearance_of(row: &SqliteRow) -> Result<Option<Clearance>, StoreError> {
    let text: Option<&str> = row.try_get("clearance")?;
    text.map(|text| value_of(text, "clearance")).transpose()
}

fn bands_of(row: &SqliteRow) -> Result<Vec<HeightBand>, StoreError> {
    let ends: Vec<[f64; 2]> = json(row, "bands")?;
    let bands = ends.into_iter();
    let bands = bands.map(|[from_m, to_m]| HeightBand::new(from_m, to_m));
    bands
        .collect::<Result<_, _>>()
        .map_err(|_| corrupt("bands"))
}

fn shift_of(row: &SqliteRow) -> Result<Option<Vector2<f64>>, StoreError> {
    let (x, y): (Option<f64>, Option<f64>) = (row.try_get("shift_x")?, row.try_get("shift_y")?);
    Ok(x.zip(y).map(|(x, y)| Vector2::new(x, y)))
}

fn residual_of(row: &SqliteRow) -> Result<Option<AlertResidual>, StoreError> {
    let edge_id: Option<i64> = row.try_get("residual_edge")?;
    let Some(edge_id) = edge_id else {
        return Ok(None);
    };
    Ok(Some(AlertResidual {
        edge_id: EdgeId(edge_id),
        delta_f: row.try_get("residual_delta_f")?,
        threshold: row.try_get("residual_threshold")?,
        ratio: row.try_get("residual_ratio")?,
        p_value: row.try_get("residual_p_value")?,
        seed_rule: row.try_get("residual_seed_rule")?,
    }))
}

fn history_of(row: &SqliteRow) -> Result<Vec<HistoryEntry>, StoreError> {
    type Row = (
        i64,
        String,
        i64,
        String,
        Option<String>,
        Option<DismissReason>,
    );
    let mut rows: Vec<Row> = json(row, "history")?;
    rows.sort_by_key(|(position, ..)| *position);
    let entry = |(_, status, at_us, by, note, reason): Row| {
        Ok(HistoryEntry {
            status: value_of(&status, "history")?,
            at: Timestamp::from_microsecond(at_us).map_err(|_| corrupt("history"))?,
            by,
            note,
            reason,
        })
    };
    rows.into_iter().map(entry).collect()
}

fn handling_of(row: &SqliteRow) -> Result<Handling, StoreError> {
    let changes: Option<i64> = row.try_get("handling_changes")?;
    let comments: Option<i64> = row.try_get("comments")?;
    let muted_until: Option<i64> = row.try_get("muted_until_us")?;
    let muted = muted_until.map(|until| match until {
        NO_END_US => Ok(Muted { until: None }),
        until => Timestamp::from_microsecond(until)
            .map(|until| Muted { until: Some(until) })
            .map_err(|_| corrupt("muted_until_us")),
    });
    Ok(Handling {
        changes: changes.unwrap_or(0),
        assignee: row.try_get("assignee")?,
        comments: comments.unwrap_or(0),
        muted: muted.transpose()?,
    })
}
