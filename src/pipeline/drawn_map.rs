//! A route's map as it is drawn, without a service.

use crate::ids::RouteId;
use crate::render::{Decided, Look, MAP_RESOLUTION_M, OccupancyGrid};
use crate::store::Store;

/// The map of a route as people accepted it; `None` while nothing is in it.
///
/// # Errors
/// If the store cannot be read, or a stored scan does not decode.
pub async fn drawn_map(store: &Store, route: &RouteId) -> anyhow::Result<Option<OccupancyGrid>> {
    let nodes = store.nodes_with_scans(route).await?;
    let accepted = store.accepted_changes(route).await?;
    let pending = store.pending_changes(route).await?;
    let mut scans = Vec::with_capacity(nodes.len());
    for node in nodes.iter().filter(|node| node.node.is_localised()) {
        scans.extend(node.decoded_scans()?);
    }
    if scans.is_empty() {
        return Ok(None);
    }
    let looks = scans.iter().map(|(stamp, map_from_base, scan)| Look {
        stamp: *stamp,
        map_from_base: *map_from_base,
        scan,
    });
    let decided = Decided {
        accepted: &accepted,
        pending: &pending,
    };
    let grid = OccupancyGrid::from_looks(looks, decided, MAP_RESOLUTION_M);
    Ok(Some(grid))
}
