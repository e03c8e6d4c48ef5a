//! Which nodes are archived between two jobs, and which are reactivated.

use std::collections::BTreeSet;

use anyhow::Context;

use super::options::PipelineOptions;
use super::workspace::Workspace;
use crate::ids::{EdgeId, NodeId, RouteId, TripId};
use crate::mapping::{RouteMap, Stay, TRIP_TAIL};
use crate::store::{ARCHIVED_CLOSURES_MAX, AlertRecord, ArchivedClosure, Store, StoreError};

/// Of the nodes that show an alert's change this many of the oldest stay active, which date it …
const ALERT_OLDEST: usize = 16;
/// … and this many of the newest.
const ALERT_NEWEST: usize = 48;

/// Archives nodes that are no longer needed, before a job of `trip` extends the map. The nodes `named` by
/// the job stay.
///
/// Detector `seed` keeps everything: the paper's rule reads the places of the whole series.
///
/// # Errors
/// If the remaining graph is inconsistent; the workspace is lost then.
pub(super) fn archive(
    workspace: &mut Workspace,
    trip: &TripId,
    named: &[NodeId],
    options: &PipelineOptions,
) -> anyhow::Result<()> {
    if workspace.detector.keeps_as_sent() {
        return Ok(());
    }
    let mut nodes = named_by_alerts(workspace);
    nodes.extend(named);
    let leaving = workspace.map.settled_nodes(&Stay {
        stretches: options.active_segments,
        first_stretches: options.first_segments,
        trip,
        nodes: &nodes,
    });
    if leaving.is_empty() {
        return Ok(());
    }
    remember_closures(workspace, &leaving);
    let released = workspace.map.release(&leaving);
    released.context("the remaining map is inconsistent")?;
    let keyframes = workspace.map.keyframes().iter();
    let trips: BTreeSet<TripId> = keyframes.map(|keyframe| keyframe.trip.clone()).collect();
    workspace.vehicles.retain(|trip, _| trips.contains(trip));
    Ok(())
}

/// The evidence of pending alerts: of each, the oldest and the newest nodes that show the change.
fn named_by_alerts(workspace: &Workspace) -> BTreeSet<NodeId> {
    let pending = workspace.alerts.iter().filter(|a| a.status.is_pending());
    pending
        .flat_map(|alert| named_by(&workspace.map, alert))
        .collect()
}

fn named_by(map: &RouteMap, alert: &AlertRecord) -> Vec<NodeId> {
    let evidence = &alert.evidence;
    let showing = evidence.nodes.iter().filter_map(|node| {
        let position = map.graph().node_position(*node)?;
        let stamp = map.keyframes()[position].stamp;
        (stamp >= evidence.since).then_some((stamp, *node))
    });
    let mut showing: Vec<_> = showing.collect();
    showing.sort_unstable();
    if showing.len() > ALERT_OLDEST + ALERT_NEWEST {
        showing.drain(ALERT_OLDEST..showing.len() - ALERT_NEWEST);
    }
    showing.into_iter().map(|(_, node)| node).collect()
}

/// Moves the closures that end at leaving nodes to the archived ones, of which the first
/// [`ARCHIVED_CLOSURES_MAX`] stay in memory for their residual series.
fn remember_closures(workspace: &mut Workspace, leaving: &[NodeId]) {
    let subgraphs = workspace.subgraph_of_edges();
    let graph = workspace.map.graph();
    let leaves = |node: &NodeId| leaving.binary_search(node).is_ok();
    let archived = workspace.closures.iter().filter_map(|closure| {
        let edge = graph.edge(closure.edge_id)?;
        if !(leaves(&edge.from) || leaves(&edge.to)) {
            return None;
        }
        let newer = workspace.map.keyframe(edge.from.max(edge.to))?;
        Some(ArchivedClosure {
            id: edge.id,
            from: edge.from,
            to: edge.to,
            subgraph_id: subgraphs.get(&edge.id).copied(),
            delta_f: closure.delta_f,
            vehicle_id: workspace.vehicles.get(&newer.trip)?.clone(),
            given: workspace.external.contains(&edge.id),
        })
    });
    let archived: Vec<ArchivedClosure> = archived.collect();
    let gone: BTreeSet<EdgeId> = archived.iter().map(|closure| closure.id).collect();
    workspace.closures.retain(|c| !gone.contains(&c.edge_id));
    workspace.external.retain(|edge| !gone.contains(edge));
    workspace.archived_closures.extend(archived);
    workspace.archived_closures.sort_unstable_by_key(|c| c.id);
    workspace.archived_closures.truncate(ARCHIVED_CLOSURES_MAX);
}

/// Reactivates the archived end of a trip, which its next batch continues; returns these nodes.
///
/// # Errors
/// [`StoreError`].
pub(super) async fn reactivate_trip(
    store: &Store,
    route: &RouteId,
    trip: &TripId,
) -> Result<Vec<NodeId>, StoreError> {
    let archived = store.archived_tail(route, trip, TRIP_TAIL).await?;
    reactivate(store, route, archived).await
}

/// Reactivates those of some nodes, and of the ends of some edges, that are archived; returns them.
///
/// # Errors
/// [`StoreError`].
pub(super) async fn reactivate_named(
    store: &Store,
    route: &RouteId,
    nodes: &[NodeId],
    edges: &[EdgeId],
) -> Result<Vec<NodeId>, StoreError> {
    let archived = store.archived_among(route, nodes, edges).await?;
    reactivate(store, route, archived).await
}

async fn reactivate(
    store: &Store,
    route: &RouteId,
    archived: Vec<NodeId>,
) -> Result<Vec<NodeId>, StoreError> {
    if !archived.is_empty() {
        store.reactivate_nodes(route, archived.clone()).await?;
    }
    Ok(archived)
}

/// Solves the sub-graphs of reactivated nodes: the map may have moved since they were archived.
pub(super) fn solve_reactivated(map: &mut RouteMap, reactivated: &[NodeId]) {
    let graph = map.graph();
    let edges = reactivated.iter().flat_map(|node| graph.edges_at(*node));
    let as_they_are: Vec<_> = edges.map(|edge| (edge.id, edge.status)).collect();
    if !as_they_are.is_empty() {
        map.restate_edges(&as_they_are);
    }
}
