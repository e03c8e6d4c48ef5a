//! Alerts that zones mute.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::columns::{micros, optional_json, optional_time, polygon, text};
use super::error::StoreError;
use super::handling::{NO_END_US, count_open, handled_of, mute};
use crate::geometry::{Vector2, distance_to_polygon};
use crate::model::ChangeKind;

/// The zones of a route that mute alerts now.
pub(super) struct Mutes(Vec<Mute>);

/// A zone as far as it mutes.
struct Mute {
    /// Map frame, metres.
    polygon: Vec<Vector2<f64>>,
    /// Which alerts; `None` for all.
    kinds: Option<Vec<ChangeKind>>,
    until_us: i64,
}

fn mute_of(row: &SqliteRow) -> Result<Mute, StoreError> {
    Ok(Mute {
        polygon: polygon(row, "polygon")?,
        kinds: optional_json(row, "kinds")?,
        until_us: optional_time(row, "until_us")?.map_or(NO_END_US, micros),
    })
}

impl Mute {
    fn holds(&self, kind: ChangeKind, place: &Vector2<f64>) -> bool {
        let is_of_kind = self
            .kinds
            .as_ref()
            .is_none_or(|kinds| kinds.contains(&kind));
        is_of_kind && distance_to_polygon(place, &self.polygon) == 0.0
    }
}

impl Mutes {
    /// Reads those of a route.
    pub(super) async fn of(
        transaction: &mut SqliteConnection,
        route_key: i64,
    ) -> Result<Self, StoreError> {
        let rows = sqlx::query(
            "SELECT polygon, kinds, until_us FROM zones \
             WHERE route_key = $1 AND ended_at_us IS NULL AND purpose = 'mute' ORDER BY id",
        )
        .bind(route_key)
        .fetch_all(transaction)
        .await?;
        let mutes: Result<_, _> = rows.iter().map(mute_of).collect();
        mutes.map(Self)
    }

    /// Until when an alert at a place (map frame, metres) is muted; `None` if it is not.
    pub(super) fn until_us(&self, kind: ChangeKind, place: &Vector2<f64>) -> Option<i64> {
        let holding = self.0.iter().filter(|mute| mute.holds(kind, place));
        holding.map(|mute| mute.until_us).max()
    }
}

/// Brings every alert of a route that waits, or is muted, up to date with the zones that are in effect.
pub(super) async fn mute_again(
    transaction: &mut SqliteConnection,
    route_key: i64,
    at_us: i64,
) -> Result<(), StoreError> {
    let mutes = Mutes::of(transaction, route_key).await?;
    let rows = sqlx::query(
        "SELECT route_key, alert_key, revision, confirmed_revision, status, kind, x, y, \
         muted_until_us FROM alerts LEFT JOIN alert_handling USING (alert_key) \
         WHERE route_key = $1 \
         AND (status IN ('open', 'acknowledged') OR muted_until_us IS NOT NULL) \
         ORDER BY alert_key",
    )
    .bind(route_key)
    .fetch_all(&mut *transaction)
    .await?;
    for row in &rows {
        let place = Vector2::new(row.try_get("x")?, row.try_get("y")?);
        let until_us = mutes.until_us(text(row, "kind")?, &place);
        let before: Option<i64> = row.try_get("muted_until_us")?;
        if until_us != before {
            let alert = handled_of(row)?;
            mute(transaction, &alert, until_us, at_us).await?;
        }
    }
    count_open(transaction, route_key).await
}
