//! A route's map as an occupancy grid, straight from the store.

use crate::ids::RouteId;
use crate::render::{Decided, MAP_RESOLUTION_M, OccupancyGrid, PosedScan, untied_trips};
use crate::store::Store;

/// A route's map with its accepted changes; `None` while it is empty.
///
/// # Errors
/// If the store cannot be read, or a stored scan does not decode.
pub async fn drawn_map(store: &Store, route: &RouteId) -> anyhow::Result<Option<OccupancyGrid>> {
    let nodes = store.nodes_with_scans(route).await?;
    let accepted = store.accepted_changes(route).await?;
    let pending = store.pending_changes(route).await?;
    let localised = || nodes.iter().filter(|node| node.node.is_localised());
    let untied = untied_trips(localised().map(|node| (&node.node.trip_id, node.node.drift_m)));
    let mut scans = Vec::with_capacity(nodes.len());
    for node in localised() {
        let untied = untied.get(&node.node.trip_id).copied();
        let decoded = node.decoded_scans()?.into_iter();
        scans.extend(decoded.map(|taken| (untied, taken)));
    }
    if scans.is_empty() {
        return Ok(None);
    }
    let scans = scans.iter();
    let scans = scans.map(|(untied, (stamp, map_from_base, scan))| PosedScan {
        stamp: *stamp,
        map_from_base: *map_from_base,
        scan,
        untied: *untied,
    });
    let decided = Decided {
        accepted: &accepted,
        pending: &pending,
    };
    let grid = OccupancyGrid::from_posed_scans(scans, decided, MAP_RESOLUTION_M);
    Ok(Some(grid))
}
