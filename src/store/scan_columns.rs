//! The columns of a stored scan: its bytes, and the checksum that they must have.

use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::body::checksum;
use super::error::{Corruption, StoreError};
use crate::ids::{NodeId, RouteId};

/// The scan of a row.
///
/// # Errors
/// [`StoreError::Corrupt`] with [`Corruption::Scan`] if it has lost its checksum.
pub(super) fn scan_of(
    row: &SqliteRow,
    route: &RouteId,
    node_id: NodeId,
) -> Result<Vec<u8>, StoreError> {
    let scan: Vec<u8> = row.try_get("scan")?;
    let sha256: &[u8] = row.try_get("scan_sha256")?;
    if checksum(&scan) == *sha256 {
        return Ok(scan);
    }
    let route_id = route.clone();
    Err(StoreError::Corrupt(Corruption::Scan { route_id, node_id }))
}

/// The scan for a map, which goes on without one that is corrupt.
pub(super) fn sound_scan(scan: Result<Vec<u8>, StoreError>) -> Result<Option<Vec<u8>>, StoreError> {
    match scan {
        Ok(scan) => Ok(Some(scan)),
        Err(StoreError::Corrupt(what)) => {
            tracing::error!(%what, "is corrupt on the disk: the map goes on without it");
            metrics::counter!("mapshift_corrupt_scans_total").increment(1);
            Ok(None)
        }
        Err(error) => Err(error),
    }
}
