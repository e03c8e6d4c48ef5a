//! The report of a shift: what happened to alerts.

use axum::Json;
use axum::extract::State;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::extract::ApiQuery;
use super::filters::{checked_route, checked_time};
use super::problem::Problem;
use super::problem_responses::AlertListProblems;
use crate::model::{AlertAction, AlertStatus, ChangeKind, DismissReason, Tier};
use crate::store::{AlertRecord, DecidedRecord, DismissalCount, Report, ReportCounts, ReportScope};

/// Most entries of a list.
const ENTRIES_MAX: u32 = 1_000;
/// The length of a report by default.
const SHIFT: SignedDuration = SignedDuration::from_hours(8);

/// Which period, and which alerts.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ReportQuery {
    /// The beginning of the period, RFC 3339; 8 hours before `until` by default.
    #[param(nullable = false, format = DateTime, example = "2026-11-20T06:00:00Z")]
    since: Option<String>,
    /// The end of the period (exclusive), RFC 3339; now by default.
    #[param(nullable = false, format = DateTime, example = "2026-11-20T14:00:00Z")]
    until: Option<String>,
    /// Only alerts of this route.
    #[param(nullable = false, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    route_id: Option<String>,
}

impl ReportQuery {
    fn scope(&self, now: Timestamp) -> Result<ReportScope, Problem> {
        let until = checked_time("until", self.until.as_deref())?.unwrap_or(now);
        let since = match checked_time("since", self.since.as_deref())? {
            Some(since) => since,
            None => until.checked_sub(SHIFT).unwrap_or(Timestamp::MIN),
        };
        if since >= until {
            return Err(Problem::parameter("since", "since must be before until"));
        }
        Ok(ReportScope {
            since,
            until,
            route_id: checked_route(self.route_id.as_deref())?,
            limit: ENTRIES_MAX,
        })
    }
}

/// What happened to alerts in a period.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Report)]
pub(super) struct ReportBody {
    /// The beginning of the period.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
    /// The end of the period (exclusive).
    #[schema(value_type = String, format = DateTime)]
    until: Timestamp,
    /// Alerts raised in the period, as they are now, the newest first; at most 1,000.
    raised: Vec<ReportAlert>,
    /// Decisions made in the period, the newest first; at most 1,000.
    decided: Vec<ReportDecision>,
    /// Alerts that await a decision now and are not muted, the newest first; at most 1,000.
    open: Vec<ReportAlert>,
    /// The number of dismissals in the period by route, kind and reason; at most 1,000.
    dismissals: Vec<ReportDismissals>,
    /// The total numbers, including entries left out of the lists.
    counts: ReportCountsBody,
    /// Whether a list was truncated.
    truncated: bool,
}

/// An alert in a report.
#[derive(Debug, Serialize, ToSchema)]
struct ReportAlert {
    /// The alert.
    #[schema(format = "uuid")]
    id: String,
    /// Its route.
    route_id: String,
    /// What changed.
    kind: ChangeKind,
    /// Whether it awaits a decision, and what was decided.
    status: AlertStatus,
    /// How well it is supported.
    tier: Tier,
    /// The x of its location, map frame, metres.
    x: f64,
    /// The y of its location, map frame, metres.
    y: f64,
    /// When it was raised.
    #[schema(value_type = String, format = DateTime)]
    raised_at: Timestamp,
    /// Who is responsible for it; null if nobody is.
    #[schema(required)]
    assignee: Option<String>,
    /// Whether a zone mutes it.
    muted: bool,
}

/// A decision in a report.
#[derive(Debug, Serialize, ToSchema)]
struct ReportDecision {
    /// The alert.
    #[schema(format = "uuid")]
    alert: String,
    /// Its route.
    route_id: String,
    /// What changed.
    kind: ChangeKind,
    /// What was done.
    action: AlertAction,
    /// Who did it.
    by: String,
    /// When it was done.
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// Why it was dismissed; null if no reason was given, and for other actions.
    #[schema(required)]
    reason: Option<DismissReason>,
    /// Why, for people.
    #[schema(required)]
    note: Option<String>,
}

/// How often alerts of one kind were dismissed for one reason.
#[derive(Debug, Serialize, ToSchema)]
struct ReportDismissals {
    /// The route.
    route_id: String,
    /// The kind of the alerts.
    kind: ChangeKind,
    /// The reason; null if none was given.
    #[schema(required)]
    reason: Option<DismissReason>,
    /// The number of dismissals.
    count: i64,
}

/// Total numbers.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ReportCounts)]
struct ReportCountsBody {
    /// Alerts raised in the period.
    raised: i64,
    /// Decisions made in the period.
    decided: i64,
    /// Alerts that await a decision now and are not muted.
    open: i64,
    /// Alerts that await a decision now and are muted.
    muted: i64,
}

impl From<AlertRecord> for ReportAlert {
    fn from(alert: AlertRecord) -> Self {
        Self {
            id: alert.id.to_string(),
            route_id: alert.route_id.to_string(),
            kind: alert.evidence.kind,
            status: alert.status,
            tier: alert.evidence.tier,
            x: alert.evidence.location.x,
            y: alert.evidence.location.y,
            raised_at: alert.raised_at,
            assignee: alert.handling.assignee,
            muted: alert.handling.muted.is_some(),
        }
    }
}

impl From<DecidedRecord> for ReportDecision {
    fn from(decided: DecidedRecord) -> Self {
        Self {
            alert: decided.alert_id.to_string(),
            route_id: decided.route_id.to_string(),
            kind: decided.kind,
            action: decided.action,
            by: decided.by,
            at: decided.at,
            reason: decided.reason,
            note: decided.note,
        }
    }
}

impl From<DismissalCount> for ReportDismissals {
    fn from(dismissals: DismissalCount) -> Self {
        Self {
            route_id: dismissals.route_id.to_string(),
            kind: dismissals.kind,
            reason: dismissals.reason,
            count: dismissals.count,
        }
    }
}

impl From<ReportCounts> for ReportCountsBody {
    fn from(counts: ReportCounts) -> Self {
        Self {
            raised: counts.raised,
            decided: counts.decided,
            open: counts.open,
            muted: counts.muted,
        }
    }
}

impl ReportBody {
    fn new(scope: ReportScope, report: Report) -> Self {
        let counts = report.counts;
        let is_cut = |count: i64| count > i64::from(ENTRIES_MAX);
        Self {
            since: scope.since,
            until: scope.until,
            truncated: [counts.raised, counts.decided, counts.open]
                .map(is_cut)
                .contains(&true)
                || report.dismissals.len() == ENTRIES_MAX as usize,
            raised: report.raised.into_iter().map(Into::into).collect(),
            decided: report.decided.into_iter().map(Into::into).collect(),
            open: report.open.into_iter().map(Into::into).collect(),
            dismissals: report.dismissals.into_iter().map(Into::into).collect(),
            counts: counts.into(),
        }
    }
}

/// Read a shift report.
///
/// The alerts raised and the decisions made in a period, and the alerts that are open now.
#[utoipa::path(
    get, path = "/v1/report", tag = "alerts", params(ReportQuery),
    responses((status = 200, description = "The report", body = ReportBody), AlertListProblems)
)]
pub(super) async fn get_report(
    State(state): State<ApiState>,
    ApiQuery(query): ApiQuery<ReportQuery>,
) -> Result<Json<ReportBody>, Problem> {
    let scope = query.scope(Timestamp::now())?;
    if let Some(route) = &scope.route_id {
        state.known_route(route).await?;
    }
    let report = state.store.report(&scope).await?;
    Ok(Json(ReportBody::new(scope, report)))
}
