//! What the store keeps of zones, as values.

use jiff::Timestamp;

use crate::geometry::Vector2;
use crate::ids::{RouteId, ZoneId};
use crate::model::{ChangeKind, ZonePurpose};

/// Zones that a route can have.
pub const ZONES_MAX: u32 = 200;

/// What somebody says about a zone.
#[derive(Debug, Clone, PartialEq)]
pub struct ZoneEdit {
    /// A simple polygon, map frame, metres.
    pub polygon: Vec<Vector2<f64>>,
    /// What it does.
    pub purpose: ZonePurpose,
    /// With alerts of these kinds; `None` for all.
    pub kinds: Option<Vec<ChangeKind>>,
    /// Until then; `None` for as long as it is there.
    pub until: Option<Timestamp>,
    /// Why, for people.
    pub note: Option<String>,
}

/// A zone.
#[derive(Debug, Clone, PartialEq)]
pub struct ZoneRecord {
    /// Sorts by when it was made.
    pub id: ZoneId,
    /// Its route.
    pub route_id: RouteId,
    /// 1 when it is made, and one more with every edit.
    pub revision: i64,
    /// What it is.
    pub edit: ZoneEdit,
    /// When its time was over; `None` while it is in effect.
    pub ended_at: Option<Timestamp>,
    /// When it was made.
    pub created_at: Timestamp,
    /// By whom.
    pub created_by: String,
    /// When it was last edited.
    pub updated_at: Timestamp,
}

/// What became of a new zone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ZoneMade {
    /// It is there.
    Created,
    /// The route has as many as it can have.
    TooMany,
    /// There is no such route.
    UnknownRoute,
}
