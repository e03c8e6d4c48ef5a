//! The audit: who changed what, when, and from where.

mod export;

use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::access::Identity;
use super::extract::{ApiQuery, PageQuery};
use super::filters::{checked_route, checked_time};
use super::paging::{Listed, Part, checked_limit, cut_page, key_of_cursor};
use super::problem::Problem;
use super::problem_responses::AnyProblems;
use crate::model::AuditAction;
use crate::store::{AuditFilter, AuditRecord};

pub(super) use export::*;

/// A change that was made.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AuditEntry, example = json!({
    "id": 17, "at": "2026-11-20T06:00:00Z", "actor": "kim", "key_id": null, "address": "192.0.2.7",
    "action": "alert.dismissed", "route_id": "line-4",
    "subject": "019aa000-0000-7000-8000-00000000a001",
    "before": {"status": "open", "by": "system", "note": null},
    "after": {"status": "dismissed", "by": "kim", "note": "a parked lorry"}
}))]
pub(super) struct AuditBody {
    /// 1, 2, … in the order in which the changes were written.
    id: i64,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// Who: the name of who has signed in; `local` for requests to a service without keys, `system` for
    /// what the service did on its own.
    actor: String,
    /// The key that it was done with; null without one.
    #[schema(format = "uuid", required)]
    key_id: Option<String>,
    /// The client's address as the service sees it, of IPv6 its network of 64 bits; `command line` for keys
    /// that were made with the command; null for `system`.
    #[schema(required)]
    address: Option<String>,
    /// What was done.
    action: AuditAction,
    /// The route, which may be gone; null for what is about all routes.
    #[schema(required)]
    route_id: Option<String>,
    /// What was changed: the name of the route, the batch or the vehicle, the id of the alert, the webhook
    /// or the operation.
    subject: String,
    /// What was there before; null if nothing was. Never a secret; a `?…` at the end of a webhook's URL
    /// stands for a query, which may hold one.
    #[schema(value_type = Option<Object>, required)]
    before: Option<Value>,
    /// What is there after it; null if nothing is.
    #[schema(value_type = Option<Object>, required)]
    after: Option<Value>,
}

/// A part of the audit.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct AuditPage {
    /// The newest first.
    items: Vec<AuditBody>,
    /// Where the next part begins; null at the end.
    #[schema(required)]
    next_cursor: Option<String>,
}

impl Part for AuditPage {
    fn next_cursor(&self) -> Option<&str> {
        self.next_cursor.as_deref()
    }
}

/// Which changes to list; every condition that is given holds.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct AuditQuery {
    /// Only of this route, also if it was deleted.
    #[param(nullable = false, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    route_id: Option<String>,
    /// Only of this kind.
    #[param(nullable = false, inline)]
    action: Option<AuditAction>,
    /// Only made at this time or later, RFC 3339.
    #[param(nullable = false, format = DateTime, example = "2026-11-20T06:00:00Z")]
    since: Option<String>,
    /// Only made before this time, RFC 3339.
    #[param(nullable = false, format = DateTime, example = "2026-11-21T06:00:00Z")]
    until: Option<String>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    limit: Option<u32>,
    /// As `PageQuery` declares it.
    #[param(ignore)]
    cursor: Option<String>,
}

impl AuditQuery {
    fn filter(&self, identity: &Identity) -> Result<AuditFilter, Problem> {
        Ok(AuditFilter {
            route_id: checked_route(self.route_id.as_deref())?,
            among: identity.routes.clone(),
            action: self.action,
            since: checked_time("since", self.since.as_deref())?,
            until: checked_time("until", self.until.as_deref())?,
        })
    }
}

impl From<AuditRecord> for AuditBody {
    fn from(change: AuditRecord) -> Self {
        Self {
            id: change.key,
            at: change.at,
            actor: change.actor.name().to_owned(),
            key_id: change.actor.key().map(|key| key.to_string()),
            address: change.actor.address().map(str::to_owned),
            action: change.action,
            route_id: change.route_id.map(|route| route.to_string()),
            subject: change.subject,
            before: change.before,
            after: change.after,
        }
    }
}

/// List who changed what.
///
/// Changes of routes, alerts, zones, versions, webhooks and keys, removals and retries of batches, quarantines of vehicles, the
/// newest first, in parts: when, from which address, what was there before and after. Uploads are listed with their route. An
/// entry is written together with its change and kept for good, also when the route is deleted. What
/// changes nothing has none: a dry run, or the same settings put again. A key that is limited to routes sees
/// what was changed of these.
#[utoipa::path(
    get, path = "/v1/audit", tag = "audit", params(AuditQuery, PageQuery),
    responses((status = 200, description = "A part of the audit", body = AuditPage), AnyProblems)
)]
pub(super) async fn list_audit(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<AuditQuery>,
) -> Result<Listed<AuditPage>, Problem> {
    let limit = checked_limit(query.limit)?;
    let before: Option<i64> = key_of_cursor(query.cursor.as_deref())?;
    let filter = query.filter(&identity)?;
    let mut changes = state.store.audit_page(&filter, before, limit + 1).await?;
    let next_cursor = cut_page(&mut changes, limit, |change| change.key.to_string());
    Ok(Listed(AuditPage {
        items: changes.into_iter().map(AuditBody::from).collect(),
        next_cursor,
    }))
}
