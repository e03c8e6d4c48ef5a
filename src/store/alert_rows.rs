//! Writing alerts.

use sqlx::SqliteConnection;

use super::alert_records::{AlertRecord, HistoryEntry};
use super::columns::{json_text, micros, polygon_bytes};
use super::error::StoreError;
use super::handling::{Handled, Happening, count_open, happen};
use super::mutes::Mutes;
use super::vehicle_states::note_state;
use crate::model::{ChangeKind, Clearance, DismissReason};
use crate::scan::HeightBand;

/// Writes alerts as they are to be, new and changed ones, with an event for each, and counts the
/// route's anew.
///
/// # Errors
/// [`StoreError::InvalidResult`] if an alert is not the successor of what is stored.
pub(super) async fn write_alerts(
    transaction: &mut SqliteConnection,
    route_key: i64,
    alerts: &[AlertRecord],
) -> Result<(), StoreError> {
    if alerts.is_empty() {
        return Ok(());
    }
    let mutes = Mutes::of(transaction, route_key).await?;
    for alert in alerts {
        check(alert)?;
        let is_decision = is_decision(transaction, alert).await?;
        let (alert_key, confirmed_revision) = upsert(transaction, route_key, alert)
            .await?
            .ok_or_else(|| invalid(alert, "is not the next revision of what is stored"))?;
        add_history(transaction, alert_key, &alert.history).await?;
        link_batches(transaction, route_key, alert_key, alert).await?;
        let handled = Handled {
            route_key,
            alert_key,
            revision: alert.revision,
            confirmed_revision,
            status: alert.status,
        };
        let happening = Happening {
            muted_until_us: mutes.until_us(alert.evidence.kind, &alert.evidence.location),
            is_decision,
            at_us: micros(alert.updated_at),
        };
        happen(transaction, &handled, happening).await?;
        if alert.evidence.kind == ChangeKind::VehicleSuspect {
            for vehicle in &alert.vehicles {
                note_state(transaction, route_key, vehicle, alert.updated_at).await?;
            }
        }
    }
    count_open(transaction, route_key).await
}

/// Whether what a decision is about differs from what is stored.
async fn is_decision(
    transaction: &mut SqliteConnection,
    alert: &AlertRecord,
) -> Result<bool, StoreError> {
    let stored: Option<i64> =
        sqlx::query_scalar("SELECT decision_revision FROM alerts WHERE id = $1")
            .bind(alert.id.to_string())
            .fetch_optional(transaction)
            .await?;
    Ok(stored.is_none_or(|stored| stored < alert.decision_revision))
}

fn invalid(alert: &AlertRecord, what: &str) -> StoreError {
    StoreError::InvalidResult(format!("alert {} {what}", alert.id))
}

fn check(alert: &AlertRecord) -> Result<(), StoreError> {
    let counterpart = alert.evidence.counterpart.iter();
    let counterpart = counterpart.flat_map(|counterpart| &counterpart.region);
    let corners = alert.evidence.region.iter().chain(counterpart);
    if !corners
        .flat_map(|corner| corner.iter())
        .all(|v| v.is_finite())
    {
        return Err(invalid(alert, "has a region that is not finite"));
    }
    let shift = alert.evidence.shift;
    if shift.is_some_and(|shift| !shift.iter().all(|v| v.is_finite())) {
        return Err(invalid(alert, "has a shift that is not finite"));
    }
    if alert.history.last().map(|last| last.status) != Some(alert.status) {
        return Err(invalid(alert, "has a history that ends otherwise"));
    }
    Ok(())
}

/// Inserts a first revision, or puts a later one in the place of the one before; `None` if that is
/// not what is stored. Returns its key and the revision with which it was first confirmed, if it
/// ever was.
async fn upsert(
    transaction: &mut SqliteConnection,
    route_key: i64,
    alert: &AlertRecord,
) -> Result<Option<(i64, Option<i64>)>, StoreError> {
    let evidence = &alert.evidence;
    let residual = alert.residual.as_ref();
    let counterpart = evidence.counterpart.as_ref();
    let key = sqlx::query_as(UPSERT)
        .bind(route_key)
        .bind(alert.id.to_string())
        .bind(alert.revision)
        .bind(evidence.kind.name())
        .bind(alert.status.name())
        .bind(evidence.confidence)
        .bind(evidence.location.x)
        .bind(evidence.location.y)
        .bind(evidence.sigma_m)
        .bind(polygon_bytes(&evidence.region))
        .bind(json_text(&evidence.edges)?)
        .bind(json_text(&evidence.nodes)?)
        .bind(json_text(&evidence.trips)?)
        .bind(json_text(&alert.vehicles)?)
        .bind(length(evidence.views))
        .bind(length(evidence.laps))
        .bind(alert.first_seen.0)
        .bind(evidence.since.0)
        .bind(evidence.last_seen.0)
        .bind(evidence.until.map(|stamp| stamp.0))
        .bind(residual.map(|residual| residual.edge_id.0))
        .bind(residual.map(|residual| residual.delta_f))
        .bind(residual.and_then(|residual| residual.threshold))
        .bind(residual.and_then(|residual| residual.ratio))
        .bind(residual.map(|residual| residual.p_value))
        .bind(residual.map(|residual| residual.seed_rule))
        .bind(alert.map_version)
        .bind(json_text(&alert.related)?)
        .bind(micros(alert.raised_at))
        .bind(micros(alert.updated_at))
        .bind(evidence.tier.name())
        .bind(counterpart.map(|counterpart| counterpart.kind.name()))
        .bind(counterpart.map(|counterpart| polygon_bytes(&counterpart.region)))
        .bind(evidence.shift.map(|shift| shift.x))
        .bind(evidence.shift.map(|shift| shift.y))
        .bind(json_text(&band_ends(&evidence.bands))?)
        .bind(evidence.suspect.as_ref().map(json_text).transpose()?)
        .bind(alert.decision_revision)
        .bind(polygon_bytes(&alert.decision_region))
        .bind(alert.passes.as_ref().map(json_text).transpose()?)
        .bind(alert.clearance.map(Clearance::name))
        .fetch_optional(transaction)
        .await?;
    Ok(key)
}

/// Kind and time of raising stay as they were.
const UPSERT: &str = "INSERT INTO alerts (route_key, id, revision, kind, status, confidence, \
     x, y, sigma_m, region, edges, nodes, trips, vehicles, views, laps, first_seen_ns, since_ns, \
     last_seen_ns, until_ns, residual_edge, residual_delta_f, residual_threshold, \
     residual_ratio, residual_p_value, residual_seed_rule, map_version, related, raised_at_us, \
     updated_at_us, tier, counterpart_kind, counterpart_region, shift_x, shift_y, bands, \
     suspect, decision_revision, decision_region, passes, clearance, confirmed_revision) \
     SELECT $1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17, $18, \
     $19, $20, $21, $22, $23, $24, $25, $26, $27, $28, $29, $30, $31, $32, $33, \
     $34, $35, $36, $37, $38, $39, $40, $41, iif($31 = 'confirmed', $3, NULL) \
     WHERE $3 = 1 OR EXISTS (SELECT 1 FROM alerts WHERE id = $2) \
     ON CONFLICT (id) DO UPDATE SET revision = excluded.revision, status = excluded.status, \
     confidence = excluded.confidence, x = excluded.x, y = excluded.y, \
     sigma_m = excluded.sigma_m, region = excluded.region, edges = excluded.edges, \
     nodes = excluded.nodes, trips = excluded.trips, vehicles = excluded.vehicles, \
     views = excluded.views, laps = excluded.laps, first_seen_ns = excluded.first_seen_ns, \
     since_ns = excluded.since_ns, last_seen_ns = excluded.last_seen_ns, \
     until_ns = excluded.until_ns, residual_edge = excluded.residual_edge, \
     residual_delta_f = excluded.residual_delta_f, \
     residual_threshold = excluded.residual_threshold, \
     residual_ratio = excluded.residual_ratio, residual_p_value = excluded.residual_p_value, \
     residual_seed_rule = excluded.residual_seed_rule, map_version = excluded.map_version, \
     related = excluded.related, updated_at_us = excluded.updated_at_us, tier = excluded.tier, \
     counterpart_kind = excluded.counterpart_kind, \
     counterpart_region = excluded.counterpart_region, shift_x = excluded.shift_x, \
     shift_y = excluded.shift_y, bands = excluded.bands, suspect = excluded.suspect, \
     decision_revision = excluded.decision_revision, decision_region = excluded.decision_region, \
     passes = excluded.passes, clearance = excluded.clearance, \
     confirmed_revision = coalesce(confirmed_revision, excluded.confirmed_revision) \
     WHERE route_key = excluded.route_key AND revision = excluded.revision - 1 \
     AND kind = excluded.kind \
     AND excluded.decision_revision BETWEEN decision_revision AND decision_revision + 1 \
     RETURNING alert_key, confirmed_revision";

/// As they are kept.
fn band_ends(bands: &[HeightBand]) -> Vec<[f64; 2]> {
    bands.iter().map(|band| [band.from_m, band.to_m]).collect()
}

fn length(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// Adds the entries that are not there yet.
async fn add_history(
    transaction: &mut SqliteConnection,
    alert_key: i64,
    history: &[HistoryEntry],
) -> Result<(), StoreError> {
    for (position, entry) in history.iter().enumerate() {
        sqlx::query(
            "INSERT INTO alert_history (alert_key, position, status, at_us, by_whom, note, reason) \
             VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT DO NOTHING",
        )
        .bind(alert_key)
        .bind(length(position))
        .bind(entry.status.name())
        .bind(micros(entry.at))
        .bind(&entry.by)
        .bind(entry.note.as_deref())
        .bind(entry.reason.map(DismissReason::name))
        .execute(&mut *transaction)
        .await?;
    }
    Ok(())
}

/// Notes the batches that the alert's nodes and edges came with.
async fn link_batches(
    transaction: &mut SqliteConnection,
    route_key: i64,
    alert_key: i64,
    alert: &AlertRecord,
) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM alert_batches WHERE alert_key = $1")
        .bind(alert_key)
        .execute(&mut *transaction)
        .await?;
    sqlx::query(
        "INSERT INTO alert_batches (batch_key, alert_key) \
         SELECT batch_key, $2 FROM json_each($3) CROSS JOIN nodes \
             ON nodes.route_key = $1 AND nodes.node_id = value \
         UNION SELECT batch_key, $2 FROM json_each($4) CROSS JOIN edges \
             ON edges.route_key = $1 AND edges.edge_id = value",
    )
    .bind(route_key)
    .bind(alert_key)
    .bind(json_text(&alert.evidence.nodes)?)
    .bind(json_text(&alert.evidence.edges)?)
    .execute(transaction)
    .await?;
    Ok(())
}
