//! Enumerations that cross rooms: each value with the one text that it has everywhere.
//!
//! A text stands in columns of the database, in JSON and in query parameters, in the OpenAPI document,
//! on the maintainers' page and in pictures; here is the only table of it. What values mean to a room,
//! such as what a status allows, stands in that room. Begin with [`TextEnum`].

mod access;
mod alert;
mod audit;
mod batch;
mod calibration;
mod edge;
mod map;
mod operation;
mod residual;
mod route;
mod vehicle;
mod webhook;
mod zone;

pub use access::{InvalidHolder, Role, checked_holder};
pub use alert::{
    AlertAction, AlertStatus, BeamVerdict, ChangeKind, Clearance, DecisionResult, DismissReason,
    PassOutcome, PassSide, ShownSide, Tier,
};
pub use audit::{Actor, AuditAction, SYSTEM};
pub use batch::{BatchFlag, BatchKind, BatchStatus, RecordingFormat};
pub use calibration::Quantity;
pub use edge::{EdgeKind, EdgeStatus};
pub use map::{MapLayer, VersionAction, VersionState};
pub use operation::{OperationKind, OperationStatus};
pub use residual::{ResidualMeasurement, ResidualVerdict};
pub use route::{Detector, Stage};
pub use vehicle::VehicleState;
pub use webhook::{AlertEventKind, DeliveryFailure, DeliveryStatus, WebhookEvent, WebhookTopic};
pub use zone::ZonePurpose;

/// An enumeration whose values have texts.
pub trait TextEnum: Copy + PartialEq + 'static {
    /// Every value with its text, in the order of the definition; no text stands twice.
    const TABLE: &'static [(Self, &'static str)];

    /// The value of a text.
    ///
    /// # Errors
    /// [`UnknownText`], which lists the texts that there are.
    fn of_text(text: &str) -> Result<Self, UnknownText> {
        let mut table = Self::TABLE.iter();
        let found = table.find(|(_, known)| *known == text);
        found.map(|(value, _)| *value).ok_or_else(|| UnknownText {
            text: text.to_owned(),
            known: Self::TABLE.iter().map(|(_, known)| *known).collect(),
        })
    }
}

/// A text that no value of an enumeration has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is none of {}", .known.join(", "))]
pub struct UnknownText {
    text: String,
    known: Vec<&'static str>,
}

/// Defines an enumeration of values without fields by its table of texts. The order of the variants is
/// that of [`Ord`], and what formats without texts store: append new ones.
macro_rules! text_enum {
    (
        $(#[$attribute:meta])*
        $name:ident { $($(#[$variant_attribute:meta])* $variant:ident = $text:literal,)+ }
    ) => {
        $(#[$attribute])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[derive(serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $($(#[$variant_attribute])* #[serde(rename = $text)] $variant,)+
        }

        impl $name {
            /// Every value, in the order of the definition.
            pub const ALL: [Self; [$($text),+].len()] = [$(Self::$variant),+];

            /// Its text in columns and in JSON.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $text),+ }
            }
        }

        impl $crate::model::TextEnum for $name {
            const TABLE: &'static [(Self, &'static str)] = &[$((Self::$variant, $text)),+];
        }
    };
}
use text_enum;

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use serde::Serialize;
    use serde::de::DeserializeOwned;

    use super::*;

    /// Texts are distinct, and column, JSON and name are the same text.
    fn check<T: TextEnum + Debug + Serialize>(name: impl Fn(T) -> &'static str) {
        let mut texts: Vec<_> = T::TABLE.iter().map(|(_, text)| *text).collect();
        for (value, text) in T::TABLE {
            assert_eq!(name(*value), *text);
            assert_eq!(T::of_text(text), Ok(*value));
            let json = serde_json::to_value(value).unwrap();
            assert_eq!(json, *text, "{value:?}");
        }
        texts.sort_unstable();
        texts.dedup();
        assert_eq!(texts.len(), T::TABLE.len());
        assert!(T::of_text("").is_err());
    }

    fn check_read<T: TextEnum + Debug + Serialize + DeserializeOwned>(
        name: impl Fn(T) -> &'static str,
    ) {
        check(name);
        for (value, text) in T::TABLE {
            let read: T = serde_json::from_value((*text).into()).unwrap();
            assert_eq!(read, *value);
        }
    }

    #[test]
    fn every_value_has_one_text() {
        check_read(AlertAction::name);
        check_read(DecisionResult::name);
        check_read(DismissReason::name);
        check_read(OperationKind::name);
        check_read(OperationStatus::name);
        check_read(MapLayer::name);
        check_read(AlertEventKind::name);
        check_read(AlertStatus::name);
        check_read(AuditAction::name);
        check_read(BatchFlag::name);
        check_read(BatchKind::name);
        check_read(BatchStatus::name);
        check_read(BeamVerdict::name);
        check_read(ChangeKind::name);
        check_read(Clearance::name);
        check_read(DeliveryFailure::name);
        check_read(DeliveryStatus::name);
        check_read(Detector::name);
        check_read(EdgeKind::name);
        check_read(EdgeStatus::name);
        check_read(PassOutcome::name);
        check_read(PassSide::name);
        check_read(Quantity::name);
        check_read(RecordingFormat::name);
        check_read(ResidualMeasurement::name);
        check_read(ResidualVerdict::name);
        check_read(ShownSide::name);
        check_read(Role::name);
        check_read(Stage::name);
        check_read(Tier::name);
        check_read(VersionAction::name);
        check_read(VersionState::name);
        check_read(ZonePurpose::name);
        check_read(VehicleState::name);
        check_read(WebhookTopic::name);
        check(WebhookEvent::name);
    }

    #[test]
    fn an_unknown_text_is_answered_with_those_that_are_known() {
        let error = Tier::of_text("Confirmed").unwrap_err();
        assert_eq!(
            error.to_string(),
            "`Confirmed` is none of tentative, confirmed"
        );
    }
}
