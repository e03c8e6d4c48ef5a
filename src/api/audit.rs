//! The audit: who changed what, when, and from which address.

mod export;

use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use super::access::Identity;
use super::extract::ApiQuery;
use super::filters::{checked_route, checked_time};
use super::paging::{Listed, PageQuery, Wanted, page};
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
    /// When it was made.
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// Who made it: the name of a signed-in person or of a key; `local` for requests to a service without keys,
    /// `system` for the service itself.
    actor: String,
    /// The key that was used; null without one.
    #[schema(format = "uuid", required)]
    key_id: Option<String>,
    /// The client's address as the service sees it, for IPv6 its 64-bit network; `command line` for keys created
    /// with the command; null for `system`.
    #[schema(required)]
    address: Option<String>,
    /// What was done.
    action: AuditAction,
    /// The route, which may have been deleted; null for changes that concern all routes.
    #[schema(required)]
    route_id: Option<String>,
    /// What was changed: the name of the route, batch or vehicle, or the id of the alert, webhook or operation.
    subject: String,
    /// The state before; null if there was none. Never contains a secret: a `?…` at the end of a webhook's URL
    /// replaces its query, which might.
    #[schema(value_type = Option<Object>, required)]
    before: Option<Value>,
    /// The state after; null if there is none.
    #[schema(value_type = Option<Object>, required)]
    after: Option<Value>,
}

page! {
    /// A page of the audit.
    pub(super) struct AuditPage {
        /// The newest first.
        items: Vec<AuditBody>,
    }
}

/// Which changes to list; all given conditions must hold.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct AuditQuery {
    /// Only changes of this route, even if it has been deleted.
    #[param(nullable = false, pattern = "^[A-Za-z0-9._-]{1,64}$")]
    route_id: Option<String>,
    /// Only changes of this kind.
    #[param(nullable = false, inline)]
    action: Option<AuditAction>,
    /// Only changes made at this time or later, RFC 3339.
    #[param(nullable = false, format = DateTime, example = "2026-11-20T06:00:00Z")]
    since: Option<String>,
    /// Only changes made before this time, RFC 3339.
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

/// List the audit.
///
/// Changes of routes, alerts, zones, versions, webhooks and keys, removals and retries of batches, and quarantines
/// of vehicles, the newest first: who made each, when, from which address, and the state before and after. Uploads
/// are not listed here but as batches of their route. An entry is written in the same transaction as its change
/// and kept permanently, even if the route is deleted. Requests that change nothing, such as a dry run, have none.
/// A key that is limited to routes reads only changes of those.
#[utoipa::path(
    get, path = "/v1/audit", tag = "audit", params(AuditQuery, PageQuery),
    responses((status = 200, description = "A page of the audit", body = AuditPage), AnyProblems)
)]
pub(super) async fn list_audit(
    State(state): State<ApiState>,
    identity: Identity,
    ApiQuery(query): ApiQuery<AuditQuery>,
) -> Result<Listed<AuditPage>, Problem> {
    let wanted: Wanted<i64> = Wanted::checked(query.limit, query.cursor.as_deref())?;
    let filter = query.filter(&identity)?;
    let changes = state
        .store
        .audit_page(&filter, wanted.after, wanted.to_read());
    Ok(wanted.page(changes.await?, |change| change.key, AuditBody::from))
}
