//! Checksums of rows that a map is made of, so that a flipped bit is found and does not distort a map.
//!
//! They cover what never changes. A node's pose is left out: every solve writes it anew, and corrects
//! it if it is wrong. Rows of versions without checksums have none.

use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::error::{Corruption, StoreError};
use super::records::{EdgeRecord, NodeRecord};
use crate::geometry::{Information, Pose2};

/// Of what never changes of a node.
pub(super) fn of_node(node: &NodeRecord) -> u32 {
    let mut sum = Sum::default();
    sum.integer(node.id.0);
    sum.integer(node.stamp.0);
    sum.pose(&node.odom_from_base);
    sum.integer(i64::from(node.trip_order));
    sum.text(node.batch_id.as_str());
    sum.text(node.client_id.as_deref().unwrap_or_default());
    crc32fast::hash(&sum.0)
}

/// Of what never changes of an edge, and of what its closure says.
pub(super) fn of_edge(edge: &EdgeRecord) -> u32 {
    let mut sum = Sum::default();
    for id in [edge.id.0, edge.from.0, edge.to.0] {
        sum.integer(id);
    }
    sum.text(edge.batch_id.as_str());
    sum.text(edge.kind.name());
    sum.pose(&edge.measurement);
    sum.information(&edge.information);
    sum.number(edge.delta_f.unwrap_or(f64::NAN));
    if let Some(closure) = &edge.closure {
        sum.pose(&closure.all_points_measurement);
        sum.information(&closure.all_points_information);
        for number in [
            closure.overlap,
            closure.inlier_share,
            closure.rmse_m,
            closure.all_points_residual,
        ] {
            sum.number(number);
        }
    }
    crc32fast::hash(&sum.0)
}

/// Checks a row's checksum, if it has one.
///
/// # Errors
/// [`StoreError::Corrupt`] with what the row is.
pub(super) fn check(
    row: &SqliteRow,
    column: &'static str,
    sum: u32,
    what: Corruption,
) -> Result<(), StoreError> {
    let stored: Option<i64> = row.try_get(column)?;
    match stored {
        Some(stored) if stored != i64::from(sum) => Err(StoreError::Corrupt(what)),
        _ => Ok(()),
    }
}

/// What a checksum covers.
#[derive(Default)]
struct Sum(Vec<u8>);

impl Sum {
    fn integer(&mut self, value: i64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn number(&mut self, value: f64) {
        // SQLite does not keep the sign of a zero.
        let value = if value == 0.0 { 0.0 } else { value };
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.0.extend_from_slice(text.as_bytes());
        // Where it ends: no byte of a text.
        self.0.push(0xff);
    }

    fn pose(&mut self, pose: &Pose2) {
        for value in [pose.x, pose.y, pose.theta] {
            self.number(value);
        }
    }

    fn information(&mut self, information: &Information) {
        for value in information.upper() {
            self.number(value);
        }
    }
}
