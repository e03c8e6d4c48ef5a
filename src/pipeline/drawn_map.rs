//! A route's map as an occupancy grid, straight from the store.

use super::drawn_scans::DrawnScans;
use crate::ids::RouteId;
use crate::render::{Decided, MAP_RESOLUTION_M, OccupancyGrid};
use crate::store::Store;

/// A route's map with its accepted changes; `None` while it is empty.
///
/// # Errors
/// If the store cannot be read, or a stored scan does not decode.
pub async fn drawn_map(store: &Store, route: &RouteId) -> anyhow::Result<Option<OccupancyGrid>> {
    let nodes = store.nodes_with_scans(route).await?;
    let accepted = store.accepted_changes(route).await?;
    let pending = store.pending_changes(route).await?;
    let scans = DrawnScans::of(&nodes)?;
    if scans.is_empty() {
        return Ok(None);
    }
    let decided = Decided {
        accepted: &accepted,
        pending: &pending,
    };
    let grid = OccupancyGrid::from_posed_scans(scans.posed(), decided, MAP_RESOLUTION_M);
    Ok(Some(grid))
}
