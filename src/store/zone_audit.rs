//! What the audit has of a zone: what people set, and whether its time is over.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::audit::{self, Change};
use super::columns::json_text;
use super::error::StoreError;
use super::zone_records::{ZoneEdit, ZoneRecord};
use crate::ids::{RouteId, ZoneId};
use crate::model::{Actor, AuditAction, ChangeKind, ZonePurpose};

/// The change of a zone, as the audit has it.
pub(super) struct Audited<'a> {
    action: AuditAction,
    route: &'a RouteId,
    id: ZoneId,
}

impl<'a> Audited<'a> {
    pub(super) fn of(action: AuditAction, route: &'a RouteId, id: ZoneId) -> Self {
        Self { action, route, id }
    }

    /// Writes the row.
    pub(super) async fn write(
        &self,
        transaction: &mut SqliteConnection,
        before: Option<ZoneRecord>,
        after: Option<ZoneRecord>,
        by: &Actor,
        at: Timestamp,
    ) -> Result<(), StoreError> {
        let change = Change {
            at,
            actor: by,
            action: self.action,
            route_id: Some(self.route.as_str()),
            subject: &self.id.to_string(),
            before: before.as_ref().map(zone_text).transpose()?,
            after: after.as_ref().map(zone_text).transpose()?,
        };
        audit::write(transaction, change).await
    }
}

/// A zone as the audit has it.
fn zone_text(zone: &ZoneRecord) -> Result<String, StoreError> {
    #[derive(Serialize)]
    struct Text<'a> {
        polygon: Vec<[f64; 2]>,
        purpose: ZonePurpose,
        kinds: Option<&'a [ChangeKind]>,
        until: Option<Timestamp>,
        ended_at: Option<Timestamp>,
        note: Option<&'a str>,
    }
    let ZoneEdit {
        polygon,
        purpose,
        kinds,
        until,
        note,
    } = &zone.edit;
    json_text(&Text {
        polygon: polygon.iter().map(|corner| [corner.x, corner.y]).collect(),
        purpose: *purpose,
        kinds: kinds.as_deref(),
        until: *until,
        ended_at: zone.ended_at,
        note: note.as_deref(),
    })
}
