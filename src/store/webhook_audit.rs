//! What the audit has of a webhook: what people set, without what is secret.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::audit::{self, Change};
use super::columns::json_text;
use super::error::StoreError;
use super::webhook_records::WebhookRecord;
use crate::ids::RouteId;
use crate::model::{Actor, AuditAction, WebhookTopic};

/// Writes the row of a webhook that was registered, changed or deleted, unless everything is as it was.
pub(super) async fn note(
    transaction: &mut SqliteConnection,
    before: Option<&WebhookRecord>,
    after: Option<&WebhookRecord>,
    by: &Actor,
    at: Timestamp,
) -> Result<(), StoreError> {
    let (action, webhook) = match (before, after) {
        (None, None) => return Ok(()),
        (None, Some(after)) => (AuditAction::WebhookCreated, after),
        (Some(before), Some(after)) if is_as_before(before, after) => return Ok(()),
        (Some(_), Some(after)) => (AuditAction::WebhookChanged, after),
        (Some(before), None) => (AuditAction::WebhookDeleted, before),
    };
    let change = Change {
        at,
        actor: by,
        action,
        route_id: webhook.route_id.as_ref().map(RouteId::as_str),
        subject: &webhook.id.to_string(),
        before: before.map(set_of).transpose()?,
        after: after.map(set_of).transpose()?,
    };
    audit::write(transaction, change).await
}

/// Writes the row of a webhook whose secret was replaced: until when the one before is valid, and neither of
/// them.
pub(super) async fn note_rotation(
    transaction: &mut SqliteConnection,
    before: &WebhookRecord,
    after: &WebhookRecord,
    by: &Actor,
    at: Timestamp,
) -> Result<(), StoreError> {
    #[derive(Serialize)]
    struct Overlap {
        previous_secret_until: Option<Timestamp>,
    }
    let overlap = |webhook: &WebhookRecord| {
        json_text(&Overlap {
            previous_secret_until: webhook.previous_secret_until,
        })
    };
    let change = Change {
        at,
        actor: by,
        action: AuditAction::WebhookSecretRotated,
        route_id: after.route_id.as_ref().map(RouteId::as_str),
        subject: &after.id.to_string(),
        before: Some(overlap(before)?),
        after: Some(overlap(after)?),
    };
    audit::write(transaction, change).await
}

/// Whether nothing but its edition differs.
fn is_as_before(before: &WebhookRecord, after: &WebhookRecord) -> bool {
    let of_that_edition = WebhookRecord {
        revision: before.revision,
        updated_at: before.updated_at,
        ..after.clone()
    };
    of_that_edition == *before
}

/// What people set of it, and whether its receiver is gone. Of its URL without the query, which may hold
/// a token.
fn set_of(webhook: &WebhookRecord) -> Result<String, StoreError> {
    #[derive(Serialize)]
    struct Set<'a> {
        url: String,
        events: &'a [WebhookTopic],
        route_id: Option<&'a str>,
        description: Option<&'a str>,
        include_tentative: bool,
        active: bool,
        gone_at: Option<Timestamp>,
    }
    json_text(&Set {
        url: match webhook.url.split_once('?') {
            Some((url, _)) => format!("{url}?…"),
            None => webhook.url.clone(),
        },
        events: &webhook.events,
        route_id: webhook.route_id.as_ref().map(RouteId::as_str),
        description: webhook.description.as_deref(),
        include_tentative: webhook.include_tentative,
        active: webhook.active,
        gone_at: webhook.gone_at,
    })
}
