//! How values stand in columns: enumerations, times, names, flags.

use jiff::Timestamp;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::error::{Corruption, StoreError};
use crate::geometry::{Information, Pose2, PoseSigma, Vector2};
use crate::ids::{AlertId, BatchId, InvalidName, LidarId, RouteId, TripId, VehicleId};
use crate::model::TextEnum;

/// A client-chosen name that is stored as text.
pub(super) trait Name: Sized {
    /// Checks the name.
    fn from_text(text: String) -> Result<Self, InvalidName>;
}

macro_rules! name_column {
    ($($type:ident),+) => {
        $(impl Name for $type {
            fn from_text(text: String) -> Result<Self, InvalidName> {
                Self::new(text)
            }
        })+
    };
}

name_column!(RouteId, VehicleId, TripId, BatchId, LidarId);

/// A value that no version of this program writes.
pub(super) fn corrupt(column: &'static str) -> StoreError {
    StoreError::Corrupt(Corruption::Value { column })
}

/// The value of an enumeration's text.
///
/// # Errors
/// [`StoreError::Corrupt`] for a text that this version of the program does not know.
pub(super) fn value_of<T: TextEnum>(text: &str, column: &'static str) -> Result<T, StoreError> {
    T::of_text(text)
        .map_err(|unknown| StoreError::Corrupt(Corruption::UnknownText { column, unknown }))
}

/// An enumeration's column.
pub(super) fn text<T: TextEnum>(row: &SqliteRow, column: &'static str) -> Result<T, StoreError> {
    value_of(row.try_get(column)?, column)
}

/// A name's column.
pub(super) fn name<T: Name>(row: &SqliteRow, column: &'static str) -> Result<T, StoreError> {
    T::from_text(row.try_get(column)?).map_err(|_| corrupt(column))
}

/// A name's column, if there is one.
pub(super) fn optional_name<T: Name>(
    row: &SqliteRow,
    column: &'static str,
) -> Result<Option<T>, StoreError> {
    let text: Option<String> = row.try_get(column)?;
    text.map(T::from_text)
        .transpose()
        .map_err(|_| corrupt(column))
}

/// A time as it is stored.
pub(super) fn micros(time: Timestamp) -> i64 {
    time.as_microsecond()
}

/// A time's column, if there is one.
pub(super) fn optional_time(
    row: &SqliteRow,
    column: &'static str,
) -> Result<Option<Timestamp>, StoreError> {
    let micros: Option<i64> = row.try_get(column)?;
    micros
        .map(Timestamp::from_microsecond)
        .transpose()
        .map_err(|_| corrupt(column))
}

/// A time's column.
pub(super) fn time(row: &SqliteRow, column: &'static str) -> Result<Timestamp, StoreError> {
    optional_time(row, column)?.ok_or_else(|| corrupt(column))
}

/// Flags as they are stored.
pub(super) fn flags_text(flags: &[String]) -> String {
    serde_json::Value::from(flags).to_string()
}

/// The flags of a column's text.
pub(super) fn parse_flags(text: &str) -> Result<Vec<String>, StoreError> {
    serde_json::from_str(text).map_err(|_| corrupt("flags"))
}

/// An alert id's column.
pub(super) fn alert_id(row: &SqliteRow, column: &'static str) -> Result<AlertId, StoreError> {
    let text: &str = row.try_get(column)?;
    text.parse().map_err(|_| corrupt(column))
}

/// Numbers, names or ids as JSON. No fractions but rounded ones: others would not come back to the bit.
pub(super) fn json_text<T: Serialize + ?Sized>(values: &T) -> Result<String, StoreError> {
    serde_json::to_string(values)
        .map_err(|error| StoreError::InvalidResult(format!("it has no JSON: {error}")))
}

/// A column of JSON.
pub(super) fn json<T: DeserializeOwned>(
    row: &SqliteRow,
    column: &'static str,
) -> Result<T, StoreError> {
    serde_json::from_str(row.try_get(column)?).map_err(|_| corrupt(column))
}

/// A column of JSON, if there is one.
pub(super) fn optional_json<T: DeserializeOwned>(
    row: &SqliteRow,
    column: &'static str,
) -> Result<Option<T>, StoreError> {
    let text: Option<&str> = row.try_get(column)?;
    let value = text.map(serde_json::from_str).transpose();
    value.map_err(|_| corrupt(column))
}

/// The corners of a polygon as bytes.
pub(super) fn polygon_bytes(polygon: &[Vector2<f64>]) -> Vec<u8> {
    let numbers = polygon.iter().flat_map(|corner| [corner.x, corner.y]);
    numbers.flat_map(f64::to_le_bytes).collect()
}

/// The corners of a polygon's column.
pub(super) fn polygon(
    row: &SqliteRow,
    column: &'static str,
) -> Result<Vec<Vector2<f64>>, StoreError> {
    let bytes: &[u8] = row.try_get(column)?;
    let (numbers, rest) = bytes.as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|n| f64::from_le_bytes(*n)).collect();
    let (corners, half) = numbers.as_chunks::<2>();
    let whole = rest.is_empty() && half.is_empty();
    let finite = numbers.iter().all(|number| number.is_finite());
    if !(whole && finite) {
        return Err(corrupt(column));
    }
    Ok(corners
        .iter()
        .map(|corner| Vector2::from(*corner))
        .collect())
}

/// Three columns that make a pose.
pub(super) fn pose(row: &SqliteRow, columns: [&'static str; 3]) -> Result<Pose2, StoreError> {
    let [x, y, theta] = columns;
    // As it was stored, to the bit: wrapping again must not touch it.
    Ok(Pose2 {
        x: row.try_get(x)?,
        y: row.try_get(y)?,
        theta: row.try_get(theta)?,
    })
}

/// The three columns of a node's standard deviations.
pub(super) fn pose_sigma(row: &SqliteRow) -> Result<Option<PoseSigma>, StoreError> {
    let Some(x_m) = row.try_get("sigma_x")? else {
        return Ok(None);
    };
    Ok(Some(PoseSigma {
        x_m,
        y_m: row.try_get("sigma_y")?,
        theta_rad: row.try_get("sigma_theta")?,
    }))
}

/// Six columns that make an information matrix.
pub(super) fn information(
    row: &SqliteRow,
    columns: [&'static str; 6],
) -> Result<Information, StoreError> {
    let mut upper = [0.0; 6];
    for (value, column) in upper.iter_mut().zip(columns) {
        *value = row.try_get(column)?;
    }
    Ok(Information::from_upper(upper))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{
        AlertStatus, BatchKind, BatchStatus, ChangeKind, DeliveryStatus, EdgeKind, EdgeStatus,
        WebhookEvent,
    };

    #[test]
    fn an_unknown_text_is_a_corrupt_value_that_says_what_is_known() {
        assert_eq!(value_of("active", "status").ok(), Some(EdgeStatus::Active));
        let error = value_of::<EdgeStatus>("Active", "status").unwrap_err();
        assert_eq!(
            error.to_string(),
            "a value of status (`Active` is none of active, retired, quarantined) is corrupt on the \
             disk"
        );
    }

    /// The texts that statements compare a column with, or put into it.
    fn texts_of(statements: &str, column: &str) -> Vec<String> {
        let mut texts = Vec::new();
        for operator in [" = '", " <> '"] {
            let before = format!("{column}{operator}");
            let after = statements.split(&before).skip(1);
            texts.extend(after.filter_map(|rest| Some(rest.split_once('\'')?.0.to_owned())));
        }
        let before = format!("{column} IN (");
        let lists = statements.split(&before).skip(1);
        for list in lists.filter_map(|rest| Some(rest.split_once(')')?.0)) {
            let quoted = list.split('\'').skip(1).step_by(2);
            texts.extend(quoted.map(str::to_owned));
        }
        texts
    }

    fn has<T: TextEnum>(text: &str) -> bool {
        T::of_text(text).is_ok()
    }

    #[test]
    fn every_text_in_a_statement_is_one_of_the_model() {
        let mut found = 0;
        let sources = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/store");
        for file in std::fs::read_dir(sources).unwrap() {
            let path = file.unwrap().path();
            if path.is_dir() {
                continue;
            }
            let source = std::fs::read_to_string(&path).unwrap();
            let statements = source.split("#[cfg(test)]").next().unwrap();
            let mut check = |column, is_one: fn(&str) -> bool| {
                for text in texts_of(statements, column) {
                    assert!(is_one(&text), "{}: {column} '{text}'", path.display());
                    found += 1;
                }
            };
            check("status", |text| {
                has::<BatchStatus>(text)
                    || has::<EdgeStatus>(text)
                    || has::<AlertStatus>(text)
                    || has::<DeliveryStatus>(text)
            });
            check("kind", |text| {
                has::<BatchKind>(text) || has::<EdgeKind>(text) || has::<ChangeKind>(text)
            });
            check("event", has::<WebhookEvent>);
        }
        assert!(found > 30, "{found}");
    }

    #[test]
    fn flags_are_read_back() {
        let flags = vec!["a \"quoted\" ü".to_owned(), String::new()];
        assert_eq!(parse_flags(&flags_text(&flags)).unwrap(), flags);
        assert!(parse_flags("{").is_err());
    }
}
