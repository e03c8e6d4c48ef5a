//! Time stamps of uploads: RFC 3339, between 1970 and 2100.

use std::fmt;

use jiff::Timestamp;
use serde::Deserialize;
use serde::de::{Deserializer, Error, IgnoredAny, MapAccess, Visitor};

use super::body_error::{BatchProblem, Checked, refuse};
use crate::ids::StampNs;

/// 2100-01-01T00:00:00Z, seconds since the Unix epoch.
const STAMP_MAX_S: i64 = 4_102_444_800;

/// A time as it was sent.
#[derive(Debug, Clone, Copy)]
pub(super) struct SentStamp(Timestamp);

impl SentStamp {
    /// The time as stored. One before 2000 is of a simulation: see [`StampNs::is_simulated`].
    ///
    /// # Errors
    /// [`BatchProblem::OutOfRange`] at the pointer, if it is not between 1970 and 2100.
    pub fn checked(self, pointer: impl FnOnce() -> String) -> Checked<StampNs> {
        let nanoseconds = i64::try_from(self.0.as_nanosecond()).ok();
        match nanoseconds {
            Some(ns) if (0..STAMP_MAX_S).contains(&self.0.as_second()) => Ok(StampNs(ns)),
            _ => refuse(
                BatchProblem::OutOfRange,
                pointer(),
                format!(
                    "{} is not between 1970 and 2100: is the vehicle's clock set?",
                    self.0
                ),
            ),
        }
    }
}

impl<'de> Deserialize<'de> for SentStamp {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct StampVisitor;
        impl<'de> Visitor<'de> for StampVisitor {
            type Value = SentStamp;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an RFC 3339 time as \"2026-11-20T06:00:00.000Z\"")
            }
            fn visit_str<E: Error>(self, text: &str) -> Result<SentStamp, E> {
                text.parse().map(SentStamp).map_err(|error| {
                    E::custom(format!(
                        "{error}: send an RFC 3339 time as \"2026-11-20T06:00:00.000Z\""
                    ))
                })
            }
            fn visit_u64<E: Error>(self, number: u64) -> Result<SentStamp, E> {
                Err(E::custom(number_hint(number as f64)))
            }
            fn visit_i64<E: Error>(self, number: i64) -> Result<SentStamp, E> {
                Err(E::custom(number_hint(number as f64)))
            }
            fn visit_f64<E: Error>(self, number: f64) -> Result<SentStamp, E> {
                Err(E::custom(number_hint(number)))
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<SentStamp, A::Error> {
                // To the end, so that the mistake is found at the stamp and not within it.
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Err(A::Error::custom(
                    "this is an object: send ROS's sec and nanosec as one RFC 3339 time, as \
                     \"2026-11-20T06:00:00.000Z\"",
                ))
            }
        }
        deserializer.deserialize_any(StampVisitor)
    }
}

/// The likely meaning of a number sent as a time, and how to write it.
fn number_hint(number: f64) -> String {
    let (unit, per_s) = match number.abs() {
        n if n < 1e11 => ("seconds", 1.0),
        n if n < 1e14 => ("milliseconds", 1e3),
        n if n < 1e17 => ("microseconds", 1e6),
        _ => ("nanoseconds", 1e9),
    };
    let milliseconds = (1e3 * number / per_s).round() as i64;
    let as_text = Timestamp::from_millisecond(milliseconds).map_or_else(
        |_| "an RFC 3339 time".to_owned(),
        |time| format!("\"{time:.3}\""),
    );
    format!("{number} is a number, perhaps of Unix {unit}: send {as_text}")
}
