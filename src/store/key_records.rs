//! What the store keeps of keys and sessions, as values.

use jiff::{SignedDuration, Timestamp};

use super::secrets::Secret;
use crate::ids::{KeyId, RouteId, VehicleId};
use crate::model::Role;

/// A session ends when it was not used for so long …
pub const SESSION_IDLE_MAX: SignedDuration = SignedDuration::from_hours(12);
/// … and so long after it began.
pub const SESSION_MAX: SignedDuration = SignedDuration::from_hours(7 * 24);

/// A key to make.
#[derive(Debug, Clone)]
pub struct NewKey {
    /// Sorts by when it is made.
    pub id: KeyId,
    /// Only its digest is kept.
    pub secret: Secret,
    /// Whose it is.
    pub name: String,
    /// What its holder may do.
    pub role: Role,
    /// The vehicle that it uploads for; `None` for any.
    pub vehicle_id: Option<VehicleId>,
    /// The routes that it is limited to; `None` for all.
    pub routes: Option<Vec<RouteId>>,
    /// When.
    pub created_at: Timestamp,
    /// From then on it is no key.
    pub expires_at: Option<Timestamp>,
}

/// A key, without its secret.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyRecord {
    /// Sorts by when it was made.
    pub id: KeyId,
    /// Whose it is.
    pub name: String,
    /// What its holder may do.
    pub role: Role,
    /// The vehicle that it uploads for; `None` for any.
    pub vehicle_id: Option<VehicleId>,
    /// The routes that it is limited to; `None` for all.
    pub routes: Option<Vec<RouteId>>,
    /// When it was made.
    pub created_at: Timestamp,
    /// The name of who made it.
    pub created_by: String,
    /// Within minutes; `None` before the first use.
    pub last_used_at: Option<Timestamp>,
    /// From then on it is no key.
    pub expires_at: Option<Timestamp>,
    /// Since then it is no key.
    pub revoked_at: Option<Timestamp>,
}

impl KeyRecord {
    /// Whether its holder may still send requests with it.
    pub fn is_live(&self, now: Timestamp) -> bool {
        self.revoked_at.is_none() && self.expires_at.is_none_or(|end| now < end)
    }
}

/// A session that has begun with a key.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionRecord {
    /// The key.
    pub key: KeyRecord,
    /// When it began.
    pub created_at: Timestamp,
    /// Within minutes.
    pub last_used_at: Timestamp,
}

impl SessionRecord {
    /// Whether it goes on.
    pub fn is_live(&self, now: Timestamp) -> bool {
        let idle = now.duration_since(self.last_used_at);
        now < self.expires_at() && idle < SESSION_IDLE_MAX && self.key.is_live(now)
    }

    /// When it ends at the latest.
    pub fn expires_at(&self) -> Timestamp {
        let end = self
            .created_at
            .saturating_add(SESSION_MAX)
            .unwrap_or(Timestamp::MAX);
        self.key.expires_at.map_or(end, |key_end| key_end.min(end))
    }
}
