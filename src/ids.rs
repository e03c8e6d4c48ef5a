//! Names that clients choose, numbers that the service chooses, and time stamps.
//!
//! Must not know what they name. Begin with [`validate_name`].

use std::fmt;

use serde::{Deserialize, Serialize};
use uuid::Uuid;

/// Longest client-chosen name, in characters.
pub const NAME_LENGTH_MAX: usize = 64;

/// Why a client-chosen name was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "a name is 1 to {NAME_LENGTH_MAX} characters of A-Z a-z 0-9 . _ -, and neither \".\" nor \"..\""
)]
pub struct InvalidName;

/// Checks a client-chosen name: `[A-Za-z0-9._-]{1,64}`.
///
/// # Errors
/// [`InvalidName`] if it has another character or length.
pub fn validate_name(name: &str) -> Result<(), InvalidName> {
    let allowed = |c: u8| c.is_ascii_alphanumeric() || matches!(c, b'.' | b'_' | b'-');
    let valid = (1..=NAME_LENGTH_MAX).contains(&name.len())
        && name.bytes().all(allowed)
        && name != "."
        && name != "..";
    if valid { Ok(()) } else { Err(InvalidName) }
}

macro_rules! name_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(try_from = "String")]
        pub struct $name(String);

        impl $name {
            /// Checks a client-chosen name: `[A-Za-z0-9._-]{1,64}`.
            ///
            /// # Errors
            /// [`InvalidName`] if it has another character or length.
            pub fn new(name: impl Into<String>) -> Result<Self, InvalidName> {
                let name = name.into();
                validate_name(&name)?;
                Ok(Self(name))
            }

            /// The name as it was chosen.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl TryFrom<String> for $name {
            type Error = InvalidName;
            fn try_from(name: String) -> Result<Self, InvalidName> {
                Self::new(name)
            }
        }

        impl std::str::FromStr for $name {
            type Err = InvalidName;
            fn from_str(name: &str) -> Result<Self, InvalidName> {
                Self::new(name)
            }
        }
    };
}

name_type!(
    /// A route: one map, one pose graph.
    RouteId
);
name_type!(
    /// A vehicle; it carries one lidar or several.
    VehicleId
);
name_type!(
    /// One of the lidars of a vehicle that has several.
    LidarId
);
name_type!(
    /// One trip of one vehicle, in one odometry frame.
    TripId
);
name_type!(
    /// One upload; the key of idempotency.
    BatchId
);

macro_rules! number_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(
            Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
        )]
        pub struct $name(pub i64);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

number_type!(
    /// A node of a route's pose graph; unique within the route, never used again.
    NodeId
);
number_type!(
    /// An edge of a route's pose graph; unique within the route, never used again.
    EdgeId
);
number_type!(
    /// A time: nanoseconds since the Unix epoch, UTC.
    StampNs
);

macro_rules! uuid_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(
            Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
        )]
        pub struct $name(pub Uuid);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }

        impl std::str::FromStr for $name {
            type Err = uuid::Error;
            fn from_str(text: &str) -> Result<Self, uuid::Error> {
                text.parse().map(Self)
            }
        }
    };
}

uuid_type!(
    /// An alert: a UUID of version 7, so that alerts sort by when they were raised.
    AlertId
);
uuid_type!(
    /// An operation: a UUID of version 7, so that operations sort by when they were asked for.
    OperationId
);
uuid_type!(
    /// A webhook: a UUID of version 7, so that webhooks sort by when they were registered.
    WebhookId
);
uuid_type!(
    /// A zone: a UUID of version 7, so that zones sort by when they were made.
    ZoneId
);

uuid_type!(
    /// A key of somebody who may send requests: a UUID of version 7, so that keys sort by when they were
    /// made.
    KeyId
);

/// 2000-01-01T00:00:00Z in nanoseconds: earlier stamps are not real times.
const SIMULATED_BEFORE_NS: i64 = 946_684_800_000_000_000;

impl StampNs {
    /// Whether it is before 2000: from a simulation's clock, which begins at 0, or from one that was never set.
    /// Such stamps give only the time between scans.
    pub fn is_simulated(self) -> bool {
        self.0 < SIMULATED_BEFORE_NS
    }

    /// Seconds since the Unix epoch.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_bounded_and_plain() {
        for good in ["line-4", "a", "A.b_c-9", &"x".repeat(64)] {
            assert!(RouteId::new(good).is_ok(), "{good}");
        }
        for bad in ["", ".", "..", "a/b", "ü", "a b", "a\0", &"x".repeat(65)] {
            assert_eq!(RouteId::new(bad), Err(InvalidName), "{bad:?}");
        }
    }
}
