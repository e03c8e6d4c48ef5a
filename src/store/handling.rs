//! The handling of alerts: who sees to one, its comments, whether it is muted; and the event that every
//! change of an alert or of its handling is to streams and webhooks. The pipeline does not read the
//! handling, and no change of it raises the alert's own revision.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::text;
use super::error::StoreError;
use super::webhook_deliveries::{Happened, queue};
use super::withheld::Standing;
use crate::ids::AlertId;
use crate::model::AlertStatus;

/// What is kept in the place of a time for what does not end by itself.
pub(super) const NO_END_US: i64 = i64::MAX;

/// An alert to which something happens.
pub(super) struct Handled {
    pub(super) route_key: i64,
    pub(super) alert_key: i64,
    /// Its own revision.
    pub(super) revision: i64,
    pub(super) confirmed_revision: Option<i64>,
    pub(super) status: AlertStatus,
}

/// What happens to an alert.
#[derive(Clone, Copy)]
pub(super) struct Happening {
    /// Until when zones mute it from now on.
    pub(super) muted_until_us: Option<i64>,
    /// Whether what a decision is about has changed.
    pub(super) is_decision: bool,
    pub(super) at_us: i64,
}

/// Writes that an alert has its next revision, for streams and webhooks.
pub(super) async fn happen(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    happening: Happening,
) -> Result<(), StoreError> {
    let (changes, withheld_from, was_muted): (i64, Option<i64>, bool) =
        row_of(transaction, alert.alert_key).await?;
    let standing = Standing {
        news_from: alert.revision,
        confirmed_revision: alert.confirmed_revision,
        withheld_from,
        was_muted,
        muted: happening.muted_until_us.is_some(),
        pending: alert.status.is_pending(),
        is_decision: happening.is_decision,
    };
    set_mute(transaction, alert.alert_key, happening.muted_until_us).await?;
    let revision = alert.revision + changes;
    write_event(transaction, alert, standing, revision, happening.at_us).await
}

/// Writes that somebody has commented on an alert, or sees to it from now on: an event for streams alone.
pub(super) async fn touch(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    at_us: i64,
) -> Result<(), StoreError> {
    let (.., was_muted): (i64, Option<i64>, bool) = row_of(transaction, alert.alert_key).await?;
    handle(transaction, alert, was_muted, at_us).await
}

/// Mutes an alert until a time, or (`None`) no longer, and writes that for streams and webhooks.
pub(super) async fn mute(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    muted_until_us: Option<i64>,
    at_us: i64,
) -> Result<(), StoreError> {
    let (.., was_muted): (i64, Option<i64>, bool) = row_of(transaction, alert.alert_key).await?;
    set_mute(transaction, alert.alert_key, muted_until_us).await?;
    handle(transaction, alert, was_muted, at_us).await
}

/// Writes that the handling of an alert has changed.
async fn handle(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    was_muted: bool,
    at_us: i64,
) -> Result<(), StoreError> {
    let (changes, withheld_from, muted): (i64, Option<i64>, bool) = sqlx::query_as(
        "INSERT INTO alert_handling (alert_key, changes) VALUES ($1, 1) \
         ON CONFLICT (alert_key) DO UPDATE SET changes = changes + 1 \
         RETURNING changes, withheld_from, muted_until_us IS NOT NULL",
    )
    .bind(alert.alert_key)
    .fetch_one(&mut *transaction)
    .await?;
    let standing = Standing {
        news_from: alert.revision + 1,
        confirmed_revision: alert.confirmed_revision,
        withheld_from,
        was_muted,
        muted,
        pending: alert.status.is_pending(),
        is_decision: false,
    };
    let revision = alert.revision + changes;
    write_event(transaction, alert, standing, revision, at_us).await
}

/// How often the handling of an alert has changed, since which revision it is withheld, and whether it is
/// muted.
async fn row_of(
    transaction: &mut SqliteConnection,
    alert_key: i64,
) -> Result<(i64, Option<i64>, bool), StoreError> {
    let row = sqlx::query_as(
        "SELECT changes, withheld_from, muted_until_us IS NOT NULL FROM alert_handling \
         WHERE alert_key = $1",
    )
    .bind(alert_key)
    .fetch_optional(transaction)
    .await?;
    Ok(row.unwrap_or((0, None, false)))
}

/// Notes until when an alert is muted; an alert that never was needs no row.
async fn set_mute(
    transaction: &mut SqliteConnection,
    alert_key: i64,
    muted_until_us: Option<i64>,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO alert_handling (alert_key, muted_until_us) SELECT $1, $2 \
         WHERE $2 IS NOT NULL OR EXISTS (SELECT 1 FROM alert_handling WHERE alert_key = $1) \
         ON CONFLICT (alert_key) DO UPDATE SET muted_until_us = excluded.muted_until_us",
    )
    .bind(alert_key)
    .bind(muted_until_us)
    .execute(transaction)
    .await?;
    Ok(())
}

/// Writes an event with the revision that clients see, and queues what webhooks are sent of it.
async fn write_event(
    transaction: &mut SqliteConnection,
    alert: &Handled,
    standing: Standing,
    shown_revision: i64,
    at_us: i64,
) -> Result<(), StoreError> {
    let sequence = sqlx::query_scalar(
        "INSERT INTO alert_events (alert_key, revision, at_us, is_decision) \
         VALUES ($1, $2, $3, $4) RETURNING sequence",
    )
    .bind(alert.alert_key)
    .bind(shown_revision)
    .bind(at_us)
    .bind(standing.is_decision)
    .fetch_one(&mut *transaction)
    .await?;
    let sent = standing.sent();
    let happened = Happened {
        route_key: alert.route_key,
        alert_key: alert.alert_key,
        sequence,
        revision: shown_revision,
        event: sent.tentative,
        event_if_confirmed: sent.confirmed,
        at_us,
    };
    queue(transaction, &happened).await?;
    if sent.withheld_from != standing.withheld_from {
        sqlx::query("UPDATE alert_handling SET withheld_from = $1 WHERE alert_key = $2")
            .bind(sent.withheld_from)
            .bind(alert.alert_key)
            .execute(transaction)
            .await?;
    }
    Ok(())
}

/// Counts a route's alerts that wait for a decision: pending, and not muted.
pub(super) async fn count_open(
    transaction: &mut SqliteConnection,
    route_key: i64,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE routes SET open_alerts = (SELECT count(*) FROM alerts \
         WHERE route_key = $1 AND status IN ('open', 'acknowledged') \
         AND NOT EXISTS (SELECT 1 FROM alert_handling AS handling \
             WHERE handling.alert_key = alerts.alert_key AND muted_until_us IS NOT NULL)) \
         WHERE route_key = $1",
    )
    .bind(route_key)
    .execute(transaction)
    .await?;
    Ok(())
}

/// An alert that somebody names, with its route's name.
pub(super) async fn handled_by_id(
    transaction: &mut SqliteConnection,
    id: AlertId,
) -> Result<Option<(Handled, String)>, StoreError> {
    let row = sqlx::query(
        "SELECT route_key, alert_key, alerts.revision, confirmed_revision, status, \
         routes.id AS route_id FROM alerts JOIN routes USING (route_key) WHERE alerts.id = $1",
    )
    .bind(id.to_string())
    .fetch_optional(transaction)
    .await?;
    let handled = row.map(|row| Ok((handled_of(&row)?, row.try_get("route_id")?)));
    handled.transpose()
}

/// An alert of a row with its key, its revisions and its status.
pub(super) fn handled_of(row: &SqliteRow) -> Result<Handled, StoreError> {
    Ok(Handled {
        route_key: row.try_get("route_key")?,
        alert_key: row.try_get("alert_key")?,
        revision: row.try_get("revision")?,
        confirmed_revision: row.try_get("confirmed_revision")?,
        status: text(row, "status")?,
    })
}
