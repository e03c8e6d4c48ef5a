//! What happened to alerts in a time: raised, decided, still open.

use jiff::Timestamp;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::Store;
use super::alert_records::{AlertRecord, ReportScope};
use super::alerts::{OpenAlerts, RaisedInTime};
use super::columns::{alert_id, micros, name, text, time};
use super::error::StoreError;
use super::query::Query;
use crate::ids::{AlertId, RouteId};
use crate::model::{AlertAction, AlertStatus, ChangeKind, DismissReason};

/// What happened in a time; each list has at most as many entries as its scope allows.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Alerts that were raised in it, the newest first, as they are now.
    pub raised: Vec<AlertRecord>,
    /// What people decided in it, the newest first.
    pub decided: Vec<DecidedRecord>,
    /// Alerts that wait for a decision now and are not muted, the newest first.
    pub open: Vec<AlertRecord>,
    /// Dismissals in it, by route, kind and reason.
    pub dismissals: Vec<DismissalCount>,
    /// How many there are of each, lists cut short or not.
    pub counts: ReportCounts,
}

/// A decision of somebody.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DecidedRecord {
    /// The alert.
    pub alert_id: AlertId,
    /// Its route.
    pub route_id: RouteId,
    /// Its kind.
    pub kind: ChangeKind,
    /// What was done.
    pub action: AlertAction,
    /// By whom.
    pub by: String,
    /// When.
    pub at: Timestamp,
    /// Why it was dismissed.
    pub reason: Option<DismissReason>,
    /// Why, for people.
    pub note: Option<String>,
}

/// How often alerts of a kind were dismissed for a reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DismissalCount {
    /// On this route.
    pub route_id: RouteId,
    /// Alerts of this kind.
    pub kind: ChangeKind,
    /// For this reason; `None` where nobody says.
    pub reason: Option<DismissReason>,
    /// So often.
    pub count: i64,
}

/// How many there are of each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReportCounts {
    /// Alerts raised.
    pub raised: i64,
    /// Decisions.
    pub decided: i64,
    /// Alerts that wait, muted ones left out.
    pub open: i64,
    /// Alerts that wait and are muted.
    pub muted: i64,
}

impl Store {
    /// What happened in a time, read at one moment.
    ///
    /// # Errors
    /// [`StoreError`].
    pub async fn report(&self, scope: &ReportScope) -> Result<Report, StoreError> {
        self.read(ReportQuery(scope)).await
    }
}

struct ReportQuery<'a>(&'a ReportScope);

impl Query for ReportQuery<'_> {
    type Answer = Report;
    const ONE_SNAPSHOT: bool = true;

    async fn answer(&self, reader: &mut SqliteConnection) -> Result<Self::Answer, StoreError> {
        let Self(scope) = self;
        Ok(Report {
            raised: RaisedInTime(scope).answer(reader).await?,
            decided: decided(reader, scope).await?,
            open: OpenAlerts(scope).answer(reader).await?,
            dismissals: dismissals(reader, scope).await?,
            counts: counts(reader, scope).await?,
        })
    }
}

/// Entries of alerts' histories that somebody made in a time.
macro_rules! select_decided {
    ($columns:literal, $rest:literal) => {
        concat!(
            "SELECT ",
            $columns,
            " FROM alert_history AS entry JOIN alerts USING (alert_key) \
             JOIN routes USING (route_key) \
             WHERE entry.at_us >= $1 AND entry.at_us < $2 AND ($3 IS NULL OR routes.id = $3) \
             AND by_whom <> 'system' ",
            $rest
        )
    };
}

async fn decided(
    reader: &mut SqliteConnection,
    scope: &ReportScope,
) -> Result<Vec<DecidedRecord>, StoreError> {
    let rows = sqlx::query(select_decided!(
        "alerts.id, routes.id AS route_id, kind, entry.status AS became, by_whom, \
         entry.at_us AS decided_us, reason, note, \
         (SELECT before.status FROM alert_history AS before \
          WHERE before.alert_key = entry.alert_key AND before.position = entry.position - 1) AS was",
        "ORDER BY entry.at_us DESC, alerts.id DESC, position DESC LIMIT $4"
    ))
    .bind(micros(scope.since))
    .bind(micros(scope.until))
    .bind(scope.route_id.as_ref().map(RouteId::as_str))
    .bind(scope.limit)
    .fetch_all(reader)
    .await?;
    rows.iter().map(decided_of).collect()
}

fn decided_of(row: &SqliteRow) -> Result<DecidedRecord, StoreError> {
    let was: Option<&str> = row.try_get("was")?;
    let action = match (was, text(row, "became")?) {
        // Nothing else leads out of it.
        (Some(was), _) if was == AlertStatus::Accepted.name() => AlertAction::Undo,
        (_, AlertStatus::Acknowledged) => AlertAction::Acknowledge,
        (_, AlertStatus::Accepted) => AlertAction::Accept,
        (_, AlertStatus::Dismissed) => AlertAction::Dismiss,
        (_, AlertStatus::Open | AlertStatus::Resolved) => AlertAction::Reopen,
    };
    Ok(DecidedRecord {
        alert_id: alert_id(row, "id")?,
        route_id: name(row, "route_id")?,
        kind: text(row, "kind")?,
        action,
        by: row.try_get("by_whom")?,
        at: time(row, "decided_us")?,
        reason: reason_of(row)?,
        note: row.try_get("note")?,
    })
}

fn reason_of(row: &SqliteRow) -> Result<Option<DismissReason>, StoreError> {
    let reason: Option<&str> = row.try_get("reason")?;
    let reason = reason.map(|_| text(row, "reason"));
    reason.transpose()
}

async fn dismissals(
    reader: &mut SqliteConnection,
    scope: &ReportScope,
) -> Result<Vec<DismissalCount>, StoreError> {
    let rows = sqlx::query(select_decided!(
        "routes.id AS route_id, kind, reason, count(*) AS count",
        "AND entry.status = 'dismissed' GROUP BY routes.id, kind, reason \
         ORDER BY routes.id, kind, reason LIMIT $4"
    ))
    .bind(micros(scope.since))
    .bind(micros(scope.until))
    .bind(scope.route_id.as_ref().map(RouteId::as_str))
    .bind(scope.limit)
    .fetch_all(reader)
    .await?;
    let count = |row: &SqliteRow| {
        Ok(DismissalCount {
            route_id: name(row, "route_id")?,
            kind: text(row, "kind")?,
            reason: reason_of(row)?,
            count: row.try_get("count")?,
        })
    };
    rows.iter().map(count).collect()
}

async fn counts(
    reader: &mut SqliteConnection,
    scope: &ReportScope,
) -> Result<ReportCounts, StoreError> {
    let bounds = (micros(scope.since), micros(scope.until));
    let route = scope.route_id.as_ref().map(RouteId::as_str);
    let decided = sqlx::query_scalar(select_decided!("count(*)", ""))
        .bind(bounds.0)
        .bind(bounds.1)
        .bind(route)
        .fetch_one(&mut *reader)
        .await?;
    let raised = sqlx::query_scalar(
        "SELECT count(*) FROM alerts JOIN routes USING (route_key) \
         WHERE raised_at_us >= $1 AND raised_at_us < $2 AND ($3 IS NULL OR routes.id = $3)",
    )
    .bind(bounds.0)
    .bind(bounds.1)
    .bind(route)
    .fetch_one(&mut *reader)
    .await?;
    let (open, muted) = sqlx::query_as(
        "SELECT count(*) - count(muted_until_us), count(muted_until_us) \
         FROM alerts JOIN routes USING (route_key) LEFT JOIN alert_handling USING (alert_key) \
         WHERE status IN ('open', 'acknowledged') AND ($1 IS NULL OR routes.id = $1)",
    )
    .bind(route)
    .fetch_one(reader)
    .await?;
    Ok(ReportCounts {
        raised,
        decided,
        open,
        muted,
    })
}
