//! What the audit has of a route: what people set.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::audit::{self, Change};
use super::columns::json_text;
use super::error::StoreError;
use super::records::{GeoAnchor, RouteRecord, RouteSettings};
use crate::model::{Actor, AuditAction};

/// Writes the row of a route that was made, changed or deleted, unless everything is as it was.
pub(super) async fn note(
    transaction: &mut SqliteConnection,
    before: Option<&RouteRecord>,
    after: Option<&RouteRecord>,
    by: &Actor,
    at: Timestamp,
) -> Result<(), StoreError> {
    let (action, route) = match (before, after) {
        (None, None) => return Ok(()),
        (None, Some(after)) => (AuditAction::RouteCreated, after),
        (Some(_), Some(after)) => (AuditAction::RouteChanged, after),
        (Some(before), None) => (AuditAction::RouteDeleted, before),
    };
    let before = before.map(set_of).transpose()?;
    let after = after.map(set_of).transpose()?;
    if before == after {
        return Ok(());
    }
    let change = Change {
        at,
        actor: by,
        action,
        route_id: Some(route.id.as_str()),
        subject: route.id.as_str(),
        before,
        after,
    };
    audit::write(transaction, change).await
}

/// What people set of it.
fn set_of(route: &RouteRecord) -> Result<String, StoreError> {
    #[derive(Serialize)]
    struct Set<'a> {
        display_name: Option<&'a str>,
        geo_anchor: Option<GeoAnchor>,
        settings: &'a RouteSettings,
    }
    json_text(&Set {
        display_name: route.display_name.as_deref(),
        geo_anchor: route.geo_anchor,
        settings: &route.settings,
    })
}
